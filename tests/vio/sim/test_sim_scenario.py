"""Scenario files: all that came load and can be flown; a wrong one is told where it is wrong."""

import re

import pytest
from pydantic import BaseModel

from tagvo.errors import ConfigError
from tagvo.textfile import read_yaml
from vio.config.shipped import config_names, config_path
from vio.errors import SimulationError
from vio.sim.recording import flown_of, map_of, simulated
from vio.sim.scenario import Scenario, load_scenario, scenario_path, scenario_yaml

NAMES = config_names("scenarios")
PAPER = {f"{flight}_{v}" for flight in ("t1", "t2", "t3", "static") for v in ("qr", "hr")}


def test_the_promised_scenarios_came():
    assert PAPER | {"clean", "nuisances", "occlusion", "sparse", "fast", "along"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_each_scenario_can_be_flown(name):
    scenario = load_scenario(name)
    assert scenario.title
    flown = flown_of(scenario, map_of(scenario))
    assert flown.plan.duration_s > 30.0
    assert flown.plan.spans[0][0] == "still"
    if name in PAPER:
        flight, vehicle = name.split("_")
        assert scenario.vehicle.name == vehicle.upper()
        assert scenario.flight.name.lower() == flight


@pytest.mark.parametrize(("name", "listed", "there"), [("sparse", 68, 68), ("occlusion", 408, 285)])
def test_fewer_tags_lie_there_than_there_are(name, listed, there):
    """A sparse map lists what lies there; hidden tags are on the map all the same."""
    made = simulated(load_scenario(name, ["imu.raw_hz=null", "imu.low_pass=null"]))  # sooner
    assert len(made.tag_map) == listed
    assert len(made.scene.tag_map) == pytest.approx(there, abs=30)
    assert made.scene.tag_map.p_WT[0].tolist() != made.tag_map.p_WT[0].tolist()  # as they truly lie


def keys_of(model: type[BaseModel], prefix=""):
    for name, field in model.model_fields.items():
        kind = field.annotation
        yield f"{prefix}{name}"
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from keys_of(kind, f"{prefix}{name}.")


def test_the_first_scenario_says_every_key():
    """But for the vehicle's own file, and the parts of its shadow that follow from the vehicle."""
    data = read_yaml(config_path("scenarios/t1_qr.yaml"))
    said = set()

    def walk(value, prefix):
        for key, inner in value.items():
            said.add(f"{prefix}{key}")
            if isinstance(inner, dict):
                walk(inner, f"{prefix}{key}.")

    walk(data, "")
    walk({"vehicle": read_yaml(config_path("vehicles/qr.yaml"))}, "")
    missing = set(keys_of(Scenario)) - said
    own = {f"scene.shadow.{k}" for k in ("vehicle_m", "rotors", "centre_C_m")}
    assert missing == own


def test_a_scenario_written_out_is_the_same_scenario(tmp_path):
    for name in NAMES:
        path = tmp_path / f"{name}.yaml"
        path.write_text(scenario_yaml(load_scenario(name), "made by a test\nof two lines"))
        assert load_scenario(str(path)) == load_scenario(name)
        assert path.read_text().startswith("# made by a test\n# of two lines\n")


def test_assignments_change_single_values_and_the_vehicle():
    scenario = load_scenario("t1_qr", ["vehicle=hr", "vehicle.drag_per_s=0.7", "stream.rate_hz=5"])
    assert (scenario.vehicle.name, scenario.vehicle.drag_per_s) == ("HR", 0.7)
    assert scenario.vehicle.clearance_m == 0.25
    assert scenario.stream.rate_hz == 5.0


def test_a_file_extends_another_beside_it_or_one_that_came(tmp_path):
    (tmp_path / "mine.yaml").write_text("extends: t2_hr\nlens: {exposure_s: 0.02}\nseed: 9\n")
    (tmp_path / "yours.yaml").write_text(
        "extends: mine\nvehicle: {file: small.yaml, drag_per_s: 0.9}\nmap: {file: floor.yaml}\n"
    )
    (tmp_path / "small.yaml").write_text("name: S\ncamera_p_I: [0, 0, 0]\n")
    (tmp_path / "floor.yaml").write_text(config_path("maps/arena.yaml").read_text())
    yours = load_scenario(str(tmp_path / "yours.yaml"))
    assert (yours.seed, yours.flight.name, yours.lens.exposure_s) == (9, "T2", 0.02)
    assert yours.lens.readout_s == load_scenario("t2_hr").lens.readout_s
    assert (yours.vehicle.name, yours.vehicle.drag_per_s) == ("S", 0.9)
    assert yours.vehicle.rotors.harmonics == ()  # nothing of the other vehicle is left
    assert yours.map.file == str(tmp_path / "floor.yaml")


WRONG = [
    ("flight: {name: T1, hight: 2}", r"mine\.yaml flight: unknown 'hight'; choose one of name, sp"),
    ("speed: 2\nflight: {name: T1}", r"mine\.yaml: unknown 'speed'; choose one of title, seed"),
    ("flight: {name: T9}", r"mine\.yaml flight\.name: unknown 'T9'; choose one of T1, T2, T3"),
    ("imu: {noise: 3}", r"mine\.yaml imu: unknown 'noise'; choose one of rate_hz"),
    ("scene: {hidden_share: 2}", r"mine\.yaml scene\.hidden_share: 2; input should be less"),
    ("stream: {latency_s: [0.2, 0.1]}", r"mine\.yaml stream\.latency_s: .*a range"),
    ("seed: -1", r"mine\.yaml seed: -1; input should be greater"),
    ("vehicle: zeppelin", r"mine\.yaml vehicle: no file or vehicle 'zeppelin'; hr, qr come"),
    ("extends: mine", r"mine\.yaml: extends itself"),
    ("extends: nothing", r"nothing: no such file or scenario; choose one of along, clean"),
    ("[1, 2]", r"mine\.yaml: the file is a list; a mapping"),
    ("lens: {exposure_s: .inf}", r"mine\.yaml lens\.exposure_s: inf"),
]


@pytest.mark.parametrize(("text", "says"), WRONG)
def test_a_wrong_scenario_is_told_where(tmp_path, text, says):
    path = tmp_path / "mine.yaml"
    base = "" if "extends" in text or text[0] == "[" else "extends: t1_qr\n"
    path.write_text(base + text)
    with pytest.raises(ConfigError, match=says):
        load_scenario(str(path))


def test_a_folder_of_a_scenarios_name_is_not_in_its_way(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "clean").mkdir()
    assert load_scenario("clean").title


def test_wrong_names_and_assignments():
    with pytest.raises(ConfigError, match=r"^t9: no such file or scenario; choose one of along"):
        load_scenario("t9")
    with pytest.raises(ConfigError, match=r"here/t1\.yaml: no such file"):
        load_scenario("here/t1.yaml")
    with pytest.raises(ConfigError, match=re.escape("such as vehicle=hr or stream.rate_hz=20")):
        load_scenario("t1_qr", ["seed"])
    with pytest.raises(ConfigError, match=r"--set lens\.gian=2 lens: unknown 'gian'"):
        load_scenario("t1_qr", ["lens.gian=2"])
    assert scenario_path("t1_qr") == config_path("scenarios/t1_qr.yaml")


def test_files_that_a_scenario_names_must_be_there():
    for key in ("map.file", "camera"):
        with pytest.raises(ConfigError, match=rf"{key}: 'maps/nowhere\.yaml' is no file"):
            simulated(load_scenario("t1_qr", [f"{key}=maps/nowhere.yaml"]))


def test_a_place_that_the_sparse_map_lacks():
    with pytest.raises(SimulationError, match="tag 16 is not on"):
        simulated(load_scenario("t2_qr", ["map.every=6"]))
