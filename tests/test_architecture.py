"""The architecture is a test: who may import whom, what stays out, how long a file may grow."""

import ast
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import house
import pytest

import tagvo
import vio

ROOT = Path(__file__).parents[1]
FILES = sorted(p for top in ("tagvo", "vio") for p in (ROOT / top).rglob("*.py"))
MAX_FILE, MAX_FUNCTION = 400, 60  # lines; the aim is 60-250 and up to 40

# Folders and root modules from the bottom up; each imports only from those before it.
ORDER = (
    "tagvo.errors", "tagvo.geometry", "tagvo.textfile", "tagvo.records", "tagvo.config",
    "tagvo.kernels", "tagvo.tags", "tagvo.camera", "tagvo.detect", "tagvo.track", "tagvo.pose",
    "tagvo.pipeline", "tagvo.render", "tagvo.maps",
    "vio.errors", "vio.interrupt", "vio.terminal", "vio.records", "vio.frames", "vio.config",
    "vio.filter", "vio.evaluate", "vio.setup_check", "vio.localize", "vio.mavlink", "vio.sinks",
    "vio.sources", "vio.convert", "vio.sim", "vio.offline", "vio.doctor", "vio.sitl",
    "vio.daemon", "vio.reproduce", "vio.bench", "vio.commands", "vio.cli",
)  # fmt: skip
# The paper's stages know nothing of one another; `joint` and what judges a pose build on them.
STAGES = ("ambiguity", "fusion", "ippe", "joint", "observations", "outliers", "selection",
          "smoothing")  # fmt: skip
FREE_STEMS = {"errors", "records", "config"}
CV2 = {"tagvo.camera", "tagvo.detect", "tagvo.kernels", "tagvo.maps.printing", "tagvo.pose",
       "tagvo.render", "tagvo.tags", "vio.convert", "vio.evaluate.report", "vio.sources",
       "vio.sinks"}  # fmt: skip
COPYLEFT = {  # GPL, LGPL-linked or noncommercial: never at run time
    "evo", "ov_core", "ov_msckf", "photonlibpy", "vision_to_mavros", "aprilmav", "napavision",
    "pyqt5", "PyQt5", "PyQt6", "rospy", "rclpy",
}  # fmt: skip
CLOCKS = {"time", "time_ns", "perf_counter", "perf_counter_ns", "monotonic", "monotonic_ns",
          "process_time", "now", "utcnow", "today"}  # fmt: skip
HEAVY = ("numpy", "cv2", "scipy", "numba", "filterpy", "plotly", "matplotlib", "pydantic", "yaml",
         "apriltag", "pymavlink", "joblib", "jinja2", "rich.progress", "rich.table")  # fmt: skip


def dotted(path: Path) -> str:
    """Module name of a file: tagvo.detect.codes."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def modules() -> dict[Path, house.Module]:
    return {module.path: module for module in house.modules(ROOT)}


def tree(path: Path) -> ast.Module:
    return modules()[path].tree


def imports(path: Path, top_only: bool = False) -> tuple[str, ...]:
    """Every module that a file imports, at its top or (unless top_only) within its functions."""
    return house.imported(modules()[path], at_top=top_only)


def unit(module: str) -> str:
    """The folder or root module that a name belongs to: tagvo.detect.codes -> tagvo.detect."""
    return ".".join(module.split(".")[:2])


def test_no_import_is_relative():
    found = [(dotted(p), n) for p in FILES for n in house.nodes(tree(p))
             if isinstance(n, ast.ImportFrom)]  # fmt: skip
    assert len(found) > 1000
    assert [f"{name} line {n.lineno}" for name, n in found if n.level != 0] == []


def test_imports_run_one_way():
    rank, wrong = {name: i for i, name in enumerate(ORDER)}, []
    for path in (p for p in FILES if "." in dotted(p)):
        here = unit(dotted(path))
        assert here in rank, f"{dotted(path)} stands nowhere in ORDER: put its folder there"
        for name in imports(path):
            there = unit(name)
            if name.startswith(("tagvo.", "vio.")) and there != here:
                assert there in rank, f"{dotted(path)} imports {name}, which stands nowhere"
                if rank[there] > rank[here]:
                    wrong.append(f"{dotted(path)} imports {name}")
    assert wrong == []
    assert [name for name in ORDER if name not in {unit(dotted(p)) for p in FILES}] == []


def test_the_papers_stages_know_nothing_of_one_another():
    names = {f"tagvo.pose.{stage}" for stage in STAGES}
    files = [p for p in FILES if dotted(p) in names]
    assert len(files) == len(STAGES)
    users = [(dotted(p), n) for p in files for n in imports(p) if n.rpartition(".")[0] in names]
    assert users == []
    front = {"tagvo.detect", "tagvo.track", "tagvo.pose"}
    crossing = [
        (dotted(p), n)
        for p in FILES
        if unit(dotted(p)) in front
        for n in imports(p)
        if unit(n) in front - {unit(dotted(p))}
    ]
    assert crossing == []


def test_no_modules_import_each_other_in_a_circle():
    known = {dotted(p): p for p in FILES}

    def target(name: str) -> str:
        while name not in known and "." in name:
            name = name.rpartition(".")[0]
        return name

    needs = {m: {target(n) for n in imports(p, top_only=True)} & set(known) - {m}
             for m, p in known.items()}  # fmt: skip
    while free := [m for m, others in needs.items() if not others & set(needs)]:
        for m in free:
            del needs[m]
    assert sorted(needs) == []


def test_folders_hold_what_a_reader_can_hold():
    folders = house.folders(house.modules(ROOT))
    for folder, entries in folders.items():
        if folder in ("", "tagvo", "vio"):
            continue
        assert 2 <= len(entries) <= 18, f"{folder} holds {len(entries)}: {entries}"
    for package in ("tagvo", "vio"):
        root = [n for n in folders[package] if not n.endswith("/")]
        assert len(root) <= 8, f"{package}: {root}"


def test_no_stem_occurs_twice_within_a_package():
    names = [dotted(p) for p in FILES if p.name != "__init__.py"]
    names = [n for n in names if not n.startswith("vio.commands.")]
    stems = Counter((n.split(".")[0], n.rpartition(".")[2]) for n in names)
    twice = {stem for (_, stem), count in stems.items() if count > 1} - FREE_STEMS
    assert twice == set()


# Loops over 3 or 6 components outside `tagvo.kernels`, by module; the numbers may only shrink.
COMPONENT_LOOPS = {"tagvo.pose.joint": 2, "vio.filter.imu_noise": 1, "vio.filter.propagation": 12}


def test_kernels_take_what_a_reader_can_hold():
    found = house.modules(ROOT)
    assert sum(house.is_kernel(f) for m in found for f in house.functions(m)) > 150
    assert house.wide_kernels(found) == []
    assert house.wide_groups(found) == []


def test_loops_over_components_stand_in_the_kernels_folder():
    assert house.component_loops(house.modules(ROOT)) == COMPONENT_LOOPS


def test_commands_parse_and_print():
    """Their modules define `command` functions, and what echoes or reads options; no classes but
    enumerations and the options' own records."""
    bases = {
        ast.unparse(base)
        for path in FILES
        if dotted(path).startswith("vio.commands.")
        for node in tree(path).body
        if isinstance(node, ast.ClassDef)
        for base in node.bases
    }
    assert bases <= {"StrEnum", "Enum", "str"}


def test_tagvo_never_imports_vio():
    files = [p for p in FILES if p.is_relative_to(ROOT / "tagvo")]
    assert [p for p in files for name in imports(p) if name.split(".")[0] == "vio"] == []


def test_opencv_stays_in_the_named_places():
    users = [dotted(p) for p in FILES if "cv2" in {n.split(".")[0] for n in imports(p)}]
    assert [u for u in users if not u.startswith(tuple(f"{name}." for name in CV2))] == []
    assert users, "no module uses OpenCV: this test looks at nothing"


def test_mavlink_stays_in_its_module():
    users = [dotted(p) for p in FILES if "pymavlink" in {n.split(".")[0] for n in imports(p)}]
    logs = {"vio.convert.tlog"}  # pymavlink reads files, too
    assert [u for u in users if not u.startswith("vio.mavlink") and u not in logs] == []


def test_no_copyleft_package_at_run_time():
    assert [p for p in FILES for n in imports(p) if n.split(".")[0] in COPYLEFT] == []


def test_only_the_stopwatch_and_live_sources_read_a_clock():
    allowed = ("vio.localize.stopwatch", "vio.sources.live", "vio.mavlink.", "vio.daemon.")
    wrong = []
    for path in FILES:
        for node in house.nodes(tree(path)):
            named = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
            if named and node.value.id in ("time", "datetime", "date") and node.attr in CLOCKS:
                wrong.append(dotted(path))
        wrong += [dotted(path) for n in imports(path) if n.rpartition(".")[0] == "time"]
    assert [name for name in wrong if not name.startswith(allowed)] == []
    assert "vio.localize.stopwatch" in wrong, "the stopwatch reads a clock: this test must see it"


def test_nothing_prints():
    calls = [
        f"{dotted(p)} line {n.lineno}"
        for p in FILES
        for n in house.nodes(tree(p))
        if isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == "print"
    ]
    assert calls == []


def test_files_and_functions_stay_short():
    long_files = [p for p in FILES if len(p.read_text().splitlines()) > MAX_FILE]
    long_functions = [
        f"{dotted(p)}.{n.name}: {n.end_lineno - n.lineno + 1} lines"
        for p in FILES
        for n in house.nodes(tree(p))
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
    "Config", "ErrorStateFilter", "EvaluationError", "FlightLog", "ImuSample", "Localizer",
    "LogError", "NavState", "Trajectory", "Truth", "VioError", "comparison", "load_config",
    "read_tum", "run", "write_tum",
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
        for node in house.nodes(tree(ROOT / package / "__init__.py"))
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
