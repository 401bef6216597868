"""Parameters over a link that loses, delays and repeats; both ways of packing; silence."""

import numpy as np
import pytest
from fc_ardupilot import ArduPilot
from fc_px4 import Px4
from fc_vehicle import Vehicle

from vio.doctor.checks import names
from vio.doctor.params import ParamReader, ParamWriter, decoded, encoded, took
from vio.doctor.records import Change
from vio.mavlink.codec import Codec

STEP = 5_000_000
S = 1_000_000_000


class Lossy:
    """A reader or writer and an in-test autopilot with `loss` of all frames, either way."""

    def __init__(self, kind, loss, seed=0):
        self.rng = np.random.default_rng(seed)
        self.fc = kind(Vehicle(), np.random.default_rng(1))
        self.codec, self.loss, self.t, self.frames = Codec(1, 197), loss, 0, 0

    def run(self, ear, limit_s=60.0):
        while not ear.done and self.t < limit_s * S:
            self.t += STEP
            for message in ear.due(self.t):
                self.frames += 1
                frame = self.codec.encode(message)
                if self.rng.random() >= self.loss:
                    self.fc.receive(frame, self.t)
            for data in self.fc.poll(self.t):
                if self.rng.random() < self.loss:
                    continue
                for message in self.codec.decode(data):
                    if message.get_type() == "PARAM_VALUE":
                        ear.heard(message, self.t)
        return ear


def reader(fc):
    return ParamReader(1, fc.kind, *names(fc.kind))


@pytest.mark.parametrize("kind", [ArduPilot, Px4])
@pytest.mark.parametrize("loss", [0.0, 0.2, 0.5])
def test_all_that_exists_is_read_whatever_gets_lost(kind, loss):
    link = Lossy(kind, loss)
    got = link.run(reader(link.fc))
    wanted = {n for group in names(kind.kind) for n in group}
    there = {n: v for n, (v, _) in kind.PARAMS.items() if n in wanted}
    assert got.complete
    assert {n: v for n, v in got.values.items() if n in wanted} == pytest.approx(there)
    assert link.t < (4 if loss == 0 else 40) * S


def test_a_whole_list_is_asked_for_only_where_something_needed_is_missing():
    link = Lossy(ArduPilot, 0.0)
    link.run(reader(link.fc))
    assert "PARAM_REQUEST_LIST" not in link.fc.heard
    bare = Lossy(ArduPilot, 0.0)
    del bare.fc.params["VISO_TYPE"]
    got = bare.run(reader(bare.fc))
    assert got.complete
    assert "VISO_TYPE" not in got.values
    assert "RC1_TRIM" in got.values, "the list was read"


def test_an_autopilot_that_says_nothing_ends_the_questions():
    link = Lossy(Px4, 1.0)
    got = link.run(reader(link.fc))
    assert got.done
    assert not got.complete
    assert got.values == {}
    assert link.t < 30 * S


@pytest.mark.parametrize("value", [0, 11, -7, 921600, 2**31 - 1, -(2**31)])
def test_px4s_whole_numbers_survive_the_float(value):
    assert decoded(encoded(value, 6, 12), 6, 12) == value
    assert encoded(value, 6, 3) == value


def test_px4s_whole_numbers_come_as_bits():
    link = Lossy(Px4, 0.0)
    got = link.run(ParamReader(1, 12, ("EKF2_EV_CTRL", "RC_OF_A_NEGATIVE"), ()))
    assert got.values == {"EKF2_EV_CTRL": 11, "RC_OF_A_NEGATIVE": -7}
    assert got.kinds["EKF2_EV_CTRL"] == 6


@pytest.mark.parametrize(("kind", "integer", "real"),
                         [(ArduPilot, "VISO_TYPE", "VISO_POS_M_NSE"),
                          (Px4, "EKF2_EV_CTRL", "EKF2_EVP_NOISE")])  # fmt: skip
@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_what_is_written_is_read_back(kind, integer, real, loss):
    link = Lossy(kind, loss, seed=3)
    kinds = {n: k for n, (_, k) in link.fc.params.items()}
    changes = [Change(integer, 11.0, 15.0), Change(real, 0.05, 0.123)]
    writer = link.run(ParamWriter(1, link.fc.kind, changes, kinds))
    assert [took(c, writer.results[c.name]) for c in changes] == [True, True]
    assert link.fc.params[integer][0] == 15
    assert link.fc.params[real][0] == pytest.approx(0.123)
    assert link.fc.heard["PARAM_REQUEST_READ"], "an echo is not a reading"


def test_a_refused_write_is_told_and_the_next_goes_on():
    link = Lossy(ArduPilot, 0.0)
    kinds = {n: k for n, (_, k) in link.fc.params.items()}
    taken = link.fc.on_param_set

    def stubborn(message, t_ns):
        if message.param_id == "VISO_TYPE":
            link.fc.send_param("VISO_TYPE")  # as it was
        else:
            taken(message, t_ns)

    link.fc.on_param_set = stubborn
    changes = [Change("VISO_TYPE", 1, 3), Change("EK2_ENABLE", 0, 1)]
    writer = link.run(ParamWriter(1, 3, changes, kinds))
    assert writer.results == {"VISO_TYPE": 1.0, "EK2_ENABLE": 1.0}
    assert [took(c, writer.results[c.name]) for c in changes] == [False, True]


def test_writing_into_silence_ends():
    link = Lossy(ArduPilot, 1.0)
    writer = link.run(ParamWriter(1, 3, [Change("VISO_TYPE", 0, 1)], {}))
    assert writer.results == {"VISO_TYPE": None}
    assert not took(Change("VISO_TYPE", 0, 1), None)


def test_others_parameters_are_passed_over():
    other = Lossy(ArduPilot, 0.0)
    other.fc.mav.srcSystem = 7
    writer = ParamWriter(1, 3, [Change("VISO_TYPE", 0, 1)], {})
    other.fc.send_param("VISO_TYPE")
    for data in other.fc.out:
        for message in other.codec.decode(data):
            writer.heard(message, 0)
    assert writer.results == {}
    assert writer.due(10**9)[0].name == "PARAM_SET"
