"""What is dear to make is made once a run, by the worker that needs it first."""

import fcntl
import os


def once(tmp_path_factory, name, make):
    """The folder `name` that all workers share, after `make(folder)` has filled it."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    shared.mkdir(exist_ok=True)
    with (shared / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (shared / ".made").exists():
            make(shared)
            (shared / ".made").touch()
    return shared
