"""Fuzzes every reader: small good inputs, damaged at random, must be read or refused in words.

    python tools/fuzz.py --inputs 300000 --seed 1 [--reader NAME]

Counts tracebacks (any exception but the ones that the command line prints in one line), hangs (over
5 s of CPU, or 30 s by the clock) and inputs that took over 300 MB more than a good one; the last
line says how many, and the exit code is 1 where there was any. The same seed gives the same
inputs. A process that dies is a traceback, too; what did harm is kept with --keep DIR.
"""

import argparse
import json
import logging
import os
import random
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]

from fuzz_inputs import Reader, readers

from tagvo.errors import TagvoError
from vio.errors import VioError

HANG_S = 5.0  # of CPU: what others take of a busy machine is not the reader's
_WAITING = 6.0  # times HANG_S by the clock, for what waits and does nothing
MEMORY_KB = 300 * 1024
_BATCH = 2000  # inputs of one process
_KNOWN = (TagvoError, VioError, OSError)  # what the command line prints in one line
_LINE_CHARS = 2000  # of an error: it is one line for a person
_WORDS = [b"nan", b"inf", b"-1", b"0", b"1e308", b"1e-320", b"9" * 25, b"null", b"{}", b"[]", b"~",
          b"true", b"'", b'"', b"\x00", b"\xff\xfe", b"../", b"/dev/zero", b"!!timestamp x",
          b"&a", b"*a", b": ", b"\n", b",", b"#", b"\\0", b"0x" + b"f" * 400, b"2026-13-45",
          b"1:2:3.4"]  # fmt: skip


class Hang(BaseException):
    """An input took longer than a good one ever does."""


def damaged(good: bytes, rng: random.Random) -> bytes:
    """A good input with one to six faults of the kinds that disks, links and hands make."""
    data = bytearray(good)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        data = _FAULTS[rng.randrange(len(_FAULTS))](data, rng)
    return bytes(data[:200_000])


def _place(data: bytearray, rng: random.Random) -> int:
    return rng.randrange(len(data) + 1)


def _flip(data: bytearray, rng: random.Random) -> bytearray:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return data


def _byte(data: bytearray, rng: random.Random) -> bytearray:
    if data:
        data[rng.randrange(len(data))] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return data


def _cut(data: bytearray, rng: random.Random) -> bytearray:
    return data[: _place(data, rng)]


def _drop(data: bytearray, rng: random.Random) -> bytearray:
    at = _place(data, rng)
    del data[at : at + rng.choice((1, 2, 8, 40))]
    return data


def _twice(data: bytearray, rng: random.Random) -> bytearray:
    at, n = _place(data, rng), rng.choice((1, 4, 16, 100))
    data[at:at] = data[at : at + n] * rng.choice((1, 2, 50))
    return data


def _word(data: bytearray, rng: random.Random) -> bytearray:
    at = _place(data, rng)
    data[at : at + rng.choice((0, 0, 1, 4))] = rng.choice(_WORDS)
    return data


def _number(data: bytearray, rng: random.Random) -> bytearray:
    """A length, a count or a stamp that claims something else."""
    size = rng.choice((2, 4, 8))
    if len(data) > size:
        at = rng.randrange(len(data) - size)
        value = rng.choice((0, 1, (1 << (8 * size)) - 1, 1 << (8 * size - 1), rng.getrandbits(20)))
        data[at : at + size] = (value % (1 << (8 * size))).to_bytes(size, "little")
    return data


def _swap(data: bytearray, rng: random.Random) -> bytearray:
    """Two lines change places."""
    lines = data.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[i], lines[j] = lines[j], lines[i]
    return bytearray(b"\n".join(lines))


_FAULTS = (_flip, _byte, _cut, _drop, _twice, _word, _word, _number, _swap)


def watch() -> None:
    """Let the two alarms raise Hang."""
    signal.signal(signal.SIGPROF, _ends)
    signal.signal(signal.SIGALRM, _ends)


def _alarm(seconds: float) -> None:
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, _WAITING * seconds)


def one(reader: Reader, path: Path) -> str | None:
    """What went wrong with the input at path: traceback, hang, over_memory; None: nothing."""
    start, used, words = time.monotonic(), time.process_time(), ""
    _alarm(HANG_S)
    try:
        reader.read(path)
    except _KNOWN as err:
        words = str(err)
    except Hang:
        return "hang"
    except Exception:
        _alarm(0.0)
        sys.stderr.write(f"{reader.name}: {path}\n{traceback.format_exc()}\n")
        return "traceback"
    finally:
        _alarm(0.0)
    took = max(time.process_time() - used, (time.monotonic() - start) / _WAITING)
    if took > HANG_S:  # a library in C hears no signal
        return "hang"
    if len(words) > _LINE_CHARS:
        sys.stderr.write(f"{reader.name}: an error of {len(words)} characters: {words[:200]}\n")
        return "traceback"
    return None


def peak_kb() -> int:
    """The most memory that this process has had since the peak was reset [kB]."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split(maxsplit=1)[0])


def batch(reader: Reader, seed: str, count: int, folder: Path, keep: Path | None) -> Counter[str]:
    """Damage and read `count` inputs in this process."""
    rng, found = random.Random(seed), Counter[str]()
    path = folder / reader.file
    path.write_bytes(reader.inputs[0])
    reader.read(path)  # loads what it needs; a good input has no fault
    with open("/proc/self/clear_refs", "w") as reset:
        reset.write("5")  # the peak counts from here; getrusage's is inherited
    top_kb = peak_kb()
    for k in range(count):
        data = damaged(rng.choice(reader.inputs), rng)
        path.write_bytes(data)
        fault = one(reader, path)
        now_kb = peak_kb()
        if fault is None and now_kb - top_kb > MEMORY_KB:
            fault, top_kb = "over_memory", now_kb
        if fault is not None:
            found[fault] += 1
            if keep is not None:
                (keep / f"{reader.name}-{seed.replace(' ', '-')}-{k}-{fault}").write_bytes(data)
    return found


def in_child(
    reader: Reader, seed: str, count: int, folder: Path, keep: Path | None
) -> Counter[str]:
    """A batch in a process of its own: one that dies takes nobody along."""
    take, give = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(take)
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)  # libraries talk
        with os.fdopen(give, "w") as pipe:
            json.dump(batch(reader, seed, count, folder, keep), pipe)
        os._exit(0)
    os.close(give)
    with os.fdopen(take) as pipe:
        text = pipe.read()
    _, status = os.waitpid(child, 0)
    if status == 0 and text:
        return Counter(json.loads(text))
    sys.stderr.write(f"{reader.name}: the process died ({status}), seed {seed}\n")
    if keep is not None and (folder / reader.file).exists():
        (keep / f"{reader.name}-died").write_bytes((folder / reader.file).read_bytes())
    return Counter({"traceback": 1})


def _memory() -> str | None:
    """A folder in memory where there is one: a disk takes longer than a reader."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def fuzz(inputs: int, seed: int, name: str | None, keep: Path | None) -> Counter[str]:
    """Spread the inputs over the readers by weight; what was found, and `inputs`."""
    total = Counter[str]()
    with tempfile.TemporaryDirectory(dir=_memory()) as scratch:
        chosen = [r for r in readers(Path(scratch)) if name in (None, r.name)]
        if not chosen:
            raise SystemExit(f"--reader {name}: unknown; see tools/fuzz_inputs.py")
        weight = sum(r.weight for r in chosen)
        for reader in chosen:
            left = max(1, round(inputs * reader.weight / weight))
            folder, start, found = (
                Path(scratch) / f"f-{reader.name}",
                time.monotonic(),
                Counter[str](),
            )
            folder.mkdir()
            for k in range(0, left, _BATCH):
                count = min(_BATCH, left - k)
                found += in_child(reader, f"{seed} {reader.name} {k}", count, folder, keep)
            took = time.monotonic() - start
            sys.stdout.write(
                f"{reader.name:12} {left:7} inputs {took:7.1f} s {dict(found) or ''}\n"
            )
            sys.stdout.flush()
            total += found
            total["inputs"] += left
    return total


def _ends(number: int, frame: Any) -> None:
    raise Hang


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", default=None, help="one reader alone")
    parser.add_argument("--keep", type=Path, default=None, help="folder for what did harm")
    asked = parser.parse_args()
    watch()
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore", DeprecationWarning)
    if asked.keep is not None:
        asked.keep.mkdir(parents=True, exist_ok=True)
    n = fuzz(asked.inputs, asked.seed, asked.reader, asked.keep)
    counts = n["traceback"], n["hang"], n["over_memory"]
    sys.stdout.write(
        "inputs {} tracebacks {} hangs {} over_memory {}\n".format(n["inputs"], *counts)
    )
    raise SystemExit(1 if any(counts) else 0)


if __name__ == "__main__":
    main()
