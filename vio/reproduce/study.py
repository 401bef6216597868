"""Flies many tasks, on several cores or on a cluster; what is done is kept and not done again."""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import tagvo
import vio
from tagvo.textfile import write_atomic
from vio.errors import SimulationError, VioError
from vio.reproduce.fly import fly
from vio.reproduce.records import Score, Task

_CLUSTER_S = 10.0  # until its scheduler must have answered


def code_version() -> str:
    """A name for the code and the configurations that results depend on."""
    digest = hashlib.sha256()
    homes = [Path(m.__file__).parent for m in (tagvo, vio) if m.__file__]
    homes += [Path(vio.__file__ or "").parents[1] / "configs"]
    for path in sorted(p for home in homes for p in home.rglob("*") if _counts(p)):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _counts(path: Path) -> bool:
    return path.suffix in (".py", ".yaml") and path.name not in ("tables.py", "orderings.py")


def file_of(task: Task, folder: Path, version: str) -> Path:
    """Where the scores of a task are kept."""
    text = json.dumps([version, asdict(task)], sort_keys=True)
    return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}.json"


def kept(path: Path) -> list[Score] | None:
    """The scores of a file; None where there is none that can be read."""
    try:
        return [Score(**row) for row in json.loads(path.read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError):
        return None


def flown(task: Task, path: Path | None) -> list[Score]:
    """Fly a task and keep its scores in a file at once (None: do not)."""
    try:
        scores = fly(task)
    except SimulationError as err:
        raise SimulationError(f"{task.scenario} {' '.join(task.words)}: {err}") from None
    if path is not None:
        write_atomic(path, json.dumps([asdict(s) for s in scores]) + "\n")
    return scores


def fly_all(
    tasks: Sequence[Task],
    folder: Path,
    jobs: int,
    cluster: str | None,
    step: Callable[[], None] = lambda: None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[list[Score]]:
    """The scores of each task as they become known; ends early where `stop` says so."""
    folder.mkdir(parents=True, exist_ok=True)
    version = code_version()
    todo: list[tuple[Task, Path]] = []
    for task in tasks:
        path = file_of(task, folder, version)
        scores = kept(path)
        if scores is None:
            todo.append((task, path))
        else:
            step()
            yield scores
    on = _on_cluster(cluster, todo) if cluster else _on_cores(jobs, todo)
    for scores in on:
        step()
        yield scores
        if stop():
            return


def _on_cores(jobs: int, todo: Sequence[tuple[Task, Path]]) -> Iterator[list[Score]]:
    from joblib import Parallel, delayed

    if jobs == 1:
        yield from (flown(task, path) for task, path in todo)
        return
    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    yield from parallel(delayed(flown)(task, path) for task, path in todo)


def _on_cluster(address: str, todo: Sequence[tuple[Task, Path]]) -> Iterator[list[Score]]:
    """By joblib's Dask backend; the workers need tagvio, not our folder: we write the files."""
    try:
        from distributed import Client
    except ImportError:
        raise VioError(
            "--cluster needs dask and distributed: pip install 'tagvio[cluster]'"
        ) from None
    from joblib import Parallel, delayed, parallel_config

    try:
        client: Any = Client(address, timeout=_CLUSTER_S)
    except (OSError, ValueError, TimeoutError) as err:
        raise VioError(f"--cluster {address}: no scheduler answers ({err or 'timeout'})") from None
    with client, parallel_config(backend="dask", wait_for_workers_timeout=30):
        done = Parallel()(delayed(flown)(task, None) for task, _ in todo)
    for scores, (_, path) in zip(done, todo, strict=True):
        write_atomic(path, json.dumps([asdict(s) for s in scores]) + "\n")
        yield scores
