"""The architecture is a test: who may import whom, what stays out, how long a file may grow."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import tagvo
import vio

ROOT = Path(__file__).parents[1]
FILES = sorted(p for top in ("tagvo", "vio") for p in (ROOT / top).rglob("*.py"))
MAX_FILE, MAX_FUNCTION = 400, 60  # lines; the aim is 60-250 and up to 40

# Layers from the bottom up; a module imports only from layers below its own (a package counts as
# one module and may import within itself). In the layers called stages no module imports another.
TAGVO = (
    {"errors"},
    {"geometry", "textfile", "families"},
    {"config"},
    {"compiled", "records", "bitmaps", "sceneconfig"},
    {"camera", "tagmap", "reprojection", "trace"},
    {"calibrations", "information"},
    {"camera_io"},
    {"descent"},
    {"observe", "detect", "tagpose", "ambiguity", "selection", "outliers", "fusion", "joint",
     "smoothing", "track"},
    {"decide", "lone_tag"},
    {"pipeline"},
    {"mapgen", "mapprint", "mapsurvey", "mapoverlap", "mapview", "mapcheck", "mapdraw",
     "mapformats", "mapshow", "maptile", "mapviews", "mapsearch", "mapdesign", "calibrate",
     "outlines", "shutter", "paint", "patches", "texture", "light", "sensor", "scene", "imaging",
     "render"},
)  # fmt: skip
STAGES = TAGVO[7]
VIO = (
    {"errors"},
    {
        "records",
        "frames",
        "stopwatch",
        "interrupt",
        "assets",
        "layout",
        "settings",
        "mavlink_settings",
        "daemon_settings",
        "overrides",
    },
    {"imu_gate", "imu_noise", "setup_findings"},
    {"imu", "memory", "pivot", "intake", "imucheck", "health", "setup_check"},
    {"predicted", "gate", "rig", "clock", "start"},
    {"eskf", "corners"},
    {"window"},
    {"output", "recovery"},
    {"estimator", "arms", "warmup", "setup_watch"},
    {"filter_arm"},
    {"sources", "sinks", "mavlink", "sim", "evaluate"},
    {"unmapped"},
    {"run", "doctor", "sitl"},
    {"config"},
    {"daemon", "reproduce"},
    {"commands"},
    {"cli"},
)
CV2 = {"camera", "tagpose", "joint", "render", "imaging", "sensor", "mapprint", "calibrate",
       "bitmaps", "detect"}  # fmt: skip
COPYLEFT = {  # GPL, LGPL-linked or noncommercial: never at run time
    "evo", "ov_core", "ov_msckf", "photonlibpy", "vision_to_mavros", "aprilmav", "napavision",
    "pyqt5", "PyQt5", "PyQt6", "rospy", "rclpy",
}  # fmt: skip
CLOCKS = {"time", "time_ns", "perf_counter", "perf_counter_ns", "monotonic", "monotonic_ns",
          "process_time", "now", "utcnow", "today"}  # fmt: skip
HEAVY = ("numpy", "cv2", "scipy", "numba", "filterpy", "plotly", "matplotlib", "pydantic", "yaml",
         "apriltag", "pymavlink", "joblib", "rich.progress", "rich.table")  # fmt: skip


def dotted(path: Path) -> str:
    """Module name of a file: tagvo.detect.edges."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path) -> Iterator[str]:
    """Every module that a file imports, at its top or within its functions."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def unit(module: str) -> str:
    """The part of tagvo or vio that a module belongs to: tagvo.detect.edges -> detect."""
    return [*module.split("."), ""][1]


def ranks(layers: tuple[set[str], ...]) -> dict[str, int]:
    return {name: rank for rank, names in enumerate(layers) for name in names}


@pytest.mark.parametrize(("package", "layers"), [("tagvo", TAGVO), ("vio", VIO)])
def test_imports_run_one_way(package, layers):
    rank, wrong = ranks(layers), []
    files = [p for p in FILES if p.is_relative_to(ROOT / package) and unit(dotted(p))]
    for path in files:
        here = unit(dotted(path))
        assert here in rank, f"{dotted(path)} stands in no layer of {package}: put it in one"
        for name in imports(path):
            there = unit(name)
            if not name.startswith(f"{package}.") or there == here:
                continue
            assert there in rank, f"{dotted(path)} imports {name}, which stands in no layer"
            higher = rank[there] > rank[here]
            if higher or (rank[there] == rank[here] and here in STAGES and package == "tagvo"):
                wrong.append(f"{dotted(path)} imports {name}")
    assert wrong == []


@pytest.mark.parametrize("package", ["tagvo", "vio"])
def test_no_two_modules_import_each_other(package):
    files = [p for p in FILES if p.is_relative_to(ROOT / package)]
    pairs = {(unit(dotted(p)), unit(n)) for p in files for n in imports(p) if n.startswith(package)}
    assert [(a, b) for a, b in pairs if a < b and a and (b, a) in pairs] == []


def test_tagvo_never_imports_vio():
    files = [p for p in FILES if p.is_relative_to(ROOT / "tagvo")]
    assert [p for p in files for name in imports(p) if name.split(".")[0] == "vio"] == []


def test_opencv_stays_in_the_named_places():
    allowed = {f"tagvo.{name}" for name in CV2} | {"vio.sources", "vio.sinks"}
    users = [dotted(p) for p in FILES if "cv2" in {n.split(".")[0] for n in imports(p)}]
    assert [u for u in users if ".".join(u.split(".")[:2]) not in allowed] == []
    assert users, "no module uses OpenCV: this test looks at nothing"


def test_mavlink_stays_in_its_module():
    users = [dotted(p) for p in FILES if "pymavlink" in {n.split(".")[0] for n in imports(p)}]
    logs = {"vio.sources.foreign.tlog"}  # pymavlink reads files, too
    assert [u for u in users if not u.startswith("vio.mavlink") and u not in logs] == []


def test_no_copyleft_package_at_run_time():
    assert [p for p in FILES for n in imports(p) if n.split(".")[0] in COPYLEFT] == []


def test_only_the_stopwatch_and_live_sources_read_a_clock():
    allowed = ("vio.stopwatch", "vio.sources.live", "vio.mavlink.", "vio.daemon.")
    wrong = []
    for path in FILES:
        for node in ast.walk(tree(path)):
            named = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
            if named and node.value.id in ("time", "datetime", "date") and node.attr in CLOCKS:
                wrong.append(dotted(path))
        wrong += [dotted(path) for n in imports(path) if n.rpartition(".")[0] == "time"]
    assert [name for name in wrong if not name.startswith(allowed)] == []
    assert "vio.stopwatch" in wrong, "the stopwatch reads a clock: this test must see it"


def test_nothing_prints():
    calls = [
        f"{dotted(p)} line {n.lineno}"
        for p in FILES
        for n in ast.walk(tree(p))
        if isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == "print"
    ]
    assert calls == []


def test_files_and_functions_stay_short():
    long_files = [p for p in FILES if len(p.read_text().splitlines()) > MAX_FILE]
    long_functions = [
        f"{dotted(p)}.{n.name}: {n.end_lineno - n.lineno + 1} lines"
        for p in FILES
        for n in ast.walk(tree(p))
        if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)
        and n.end_lineno - n.lineno + 1 > MAX_FUNCTION
    ]
    assert long_files == []
    assert long_functions == []


def test_every_module_says_in_its_first_line_why_it_exists():
    firsts = {dotted(p): (ast.get_docstring(tree(p)) or "").split("\n")[0] for p in FILES}
    assert [m for m, line in firsts.items() if len(line) < 20] == []


def test_every_test_file_has_a_name_of_its_own():
    names = [p.name for p in (ROOT / "tests").rglob("*.py") if p.name != "__init__.py"]
    assert sorted(names) == sorted(set(names))


PUBLIC_TAGVO = [
    "Camera", "CameraError", "ConfigError", "Detections", "DetectorError", "Frame", "MapError",
    "PoseMeasurement", "PosePrior", "TagMap", "TagVO", "TagvoConfig", "TagvoError", "Trace",
    "load_camera", "load_map", "load_tagvo_config", "render_view", "save_camera", "save_map",
]  # fmt: skip
PUBLIC_VIO = [
    "Config", "EvaluationError", "FlightLog", "ImuSample", "LogError", "Trajectory", "Truth",
    "VioError", "comparison", "load_config", "read_tum", "write_tum",
]  # fmt: skip


@pytest.mark.parametrize(("package", "names"), [(tagvo, PUBLIC_TAGVO), (vio, PUBLIC_VIO)])
def test_public_surface_is_what_is_promised(package, names):
    assert sorted(package._HOME) == names
    assert set(names) <= set(dir(package))
    for name in names:
        thing = getattr(package, name)
        assert thing.__name__ == name
        assert thing.__doc__, f"{name} is public and has no docstring"
    with pytest.raises(AttributeError, match="nonsense"):
        package.nonsense  # noqa: B018


@pytest.mark.parametrize("package", ["tagvo", "vio"])
def test_type_checkers_see_the_same_surface(package):
    """The names under TYPE_CHECKING come from the modules that `_HOME` loads them from."""
    seen = {
        alias.asname: node.module
        for node in ast.walk(tree(ROOT / package / "__init__.py"))
        if isinstance(node, ast.ImportFrom) and node.module.startswith(f"{package}.")
        for alias in node.names
    }
    homes = sys.modules[package]._HOME
    assert seen == {name: f"{package}.{home}" for name, home in homes.items()}


def loaded_by(statement: str) -> set[str]:
    """Names of all modules that are loaded once a fresh interpreter has run a statement."""
    code = f"{statement}\nimport sys\nsys.stderr.write(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stderr.split())


def calling(*words: str) -> str:
    """Python that runs `tagvio` with these words and survives its exit."""
    return (
        f"import sys; sys.argv = ['tagvio', *{list(words)}]\n"
        "from vio.cli import main\ntry: main()\nexcept SystemExit: pass"
    )


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--help",),
        ("run", "--help"),
        ("compare", "-h"),
        ("simulate", "-h"),
        ("map", "check", "-h"),
    ],
)
def test_help_loads_nothing_heavy(words):
    loaded = loaded_by(calling(*words))
    ours = [name for name in HEAVY if name != "pydantic" or len(words) < 2]  # typer's own parser
    assert [name for name in ours if name in loaded] == []
    assert "vio.cli" in loaded


def test_importing_the_packages_loads_nothing_heavy():
    loaded = loaded_by("import tagvo, vio")
    assert [name for name in HEAVY if name in loaded] == []


def test_every_subcommand_has_help():
    done = subprocess.run([sys.executable, "-c", calling("--help")], capture_output=True, text=True)
    commands = done.stdout.split("Commands:")[1].split("\n")
    names = [line.split()[0] for line in commands if line.startswith("  ") and line[2] != " "]
    assert {"run", "compare", "map"} <= set(names)
    texts = [
        line.split(maxsplit=1) for line in commands if line.startswith("  ") and line[2] != " "
    ]
    assert [words for words in texts if len(words) < 2] == []
