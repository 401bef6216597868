"""What is flown to repeat the paper's tables, and what it named as future work."""

from vio.reproduce.records import Judge, Task

VEHICLES = ("HR", "QR")
PLACES = ("XL", "Ld", "Ls1", "Ls2", "Lc")
FLIGHTS = ("T1", "T2", "T3")
COLUMNS = (
    "JBT", "ALL-notOR", "ALL-OR", "TBS-notOR", "TBS-OR", "TBS-OR-W1-CL2", "TBS-OR-W2-CL2",
    "TBS-OR-W1-QL2",
)  # fmt: skip
FEW = ("NEW", "joint", "VIO")
CALIBRATED = tuple(
    f"calibration.{key}=0" for key in ("rotation_deg", "position_m", "focal_rel", "principal_px")
)
HIDDEN, EVERY = (0.0, 0.2, 0.4, 0.6), (1, 2, 4, 8, 16)
QUICK_CASES = {"0", "0.4", "0.6", "1", "4", "16", "0 ms", "300 ms", "1 m/s", "4 m/s"}
LATENCY_S, SPEED_M_S = (0.0, 0.1, 0.2, 0.3), (1.0, 2.0, 3.0, 4.0)
RATE_HZ, QUICK_HZ = 20.0, 10.0  # of images; the paper flew 20 Hz
_MARGIN = "flight.margin_m=0.5"  # the tags of a sparse map end before the floor does
WHOLE = "flight"  # the name of all phases together


def tasks(seed: int, seeds: int, quick: bool, images: bool) -> list[Task]:
    """Everything that is flown; longest first, so that cores end together."""
    out: list[Task] = []
    for s in range(seed, seed + seeds):
        out += [_flight(f, v, s, quick, images) for f in reversed(FLIGHTS) for v in VEHICLES]
        out += [_nuisances(f, v, s, quick, images) for f in reversed(FLIGHTS) for v in VEHICLES]
        out += [_static(p, v, s, quick, images) for p in PLACES for v in VEHICLES]
        out += _future(s, quick)
    return out


def _rate(quick: bool) -> str:
    return f"stream.rate_hz={QUICK_HZ if quick else RATE_HZ:g}"


def _static(place: str, vehicle: str, seed: int, quick: bool, images: bool) -> Task:
    hover = f"flight.hover_s={2 if quick else 10}"
    words = (f"flight.place={place}", f"vehicle={vehicle.lower()}", hover, _rate(quick))
    arms = (*COLUMNS, "NEW+FIR", "joint", "VIO")
    case = f"{vehicle} {place}"
    return Task(case, "static_hr", words, seed, images, (Judge("static", (), arms),))


def _flight(flight: str, vehicle: str, seed: int, quick: bool, images: bool) -> Task:
    """As the paper flew, and the same images with a rig that is calibrated exactly."""
    arms = ("JBT", "NEW", "NEW+FIR", "JBT in the filter", "joint", "VIO", "VIO corners")
    judges = (
        Judge("flights", (), arms),
        Judge("calibrated", CALIBRATED, ("NEW", "joint", "VIO", "VIO corners")),
    )
    name = f"{flight.lower()}_{vehicle.lower()}"
    return Task(f"{vehicle} {flight}", name, (_rate(quick),), seed, images, judges)


def _nuisances(flight: str, vehicle: str, seed: int, quick: bool, images: bool) -> Task:
    words = (f"flight.name={flight}", f"vehicle={vehicle.lower()}", _rate(quick))
    judge = Judge("nuisances", (), ("NEW", "joint", "VIO", "VIO corners"))
    return Task(f"{vehicle} {flight}", "nuisances", words, seed, images, (judge,))


def _future(seed: int, quick: bool) -> list[Task]:
    """The paper's future work, by exact corners with noise: what matters here is which are seen.

    quick: the ends of each curve and a point between.
    """
    rows: list[tuple[str, str, str, tuple[str, ...]]] = [
        *(("occlusion", f"{h:g}", "t3_qr", (f"scene.hidden_share={h:g}",)) for h in HIDDEN),
        *(("sparse", f"{n}", "t3_qr", (f"map.every={n}", _MARGIN)) for n in EVERY),
        *(
            ("latency", f"{1e3 * s:g} ms", "t3_qr", (f"stream.latency_s=[{s:g},{s:g}]",))
            for s in LATENCY_S
        ),
        *(("speed", f"{v:g} m/s", "fast", (f"flight.speed_m_s={v:g}",)) for v in SPEED_M_S),
    ]
    return [
        Task(case, scenario, words, seed, False, (Judge(study, (), FEW),))
        for study, case, scenario, words in rows
        if not quick or case in QUICK_CASES
    ]
