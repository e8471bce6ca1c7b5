"""Kill commands at random moments, take them up again, and compare with runs nobody stopped.

Every job is a real command in a process group of its own that is ended by SIGKILL after a random
share of the time it takes. After every kill no file may be torn; when a job has been killed its
share of times it is left to finish, and its files must be those of the uninterrupted run, byte for
byte.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

# Where a job has done its analysis and writes, as a share of the time it takes.
_WRITING = 0.7
JOBS = ("fit", "report", "cache", "batch")
_HEADER = "subject,environment,k_ref,b_ref,k_adj,b_adj\n"
_SCENE = """
[device]
mass = 1.0
damping = 5.0
period = 0.001
[frequency]
lower = 1.0
upper = 50.0
points = 5
[inference]
tolerance = 0.3
kinds = ["mean", "user"]
"""


class Survival:
    """A folder with studies, the commands that work on them, and what they must leave.

    Parameters
    ----------
    folder : Path
        Empty folder for everything.
    seed : int
        Of the moments.
    sampled : bool
        Whether every job samples; else only the one about the cache does, and all is done sooner.
    workers : int
        Of a batch; it has two studies for each, and one more.
    """

    def __init__(self, folder: Path, *, seed: int, sampled: bool = True, workers: int = 2) -> None:
        self.folder = folder
        self.workers = workers
        self.method = [] if sampled else ["--method", "classical"]
        self.random = random.Random(seed)
        (folder / "studies").mkdir()
        (folder / "scene.toml").write_text(_SCENE, encoding="utf-8")
        for i in range(2 * workers + 1):
            (folder / "studies" / f"s{i}.csv").write_text(_study(i), encoding="utf-8")

    def command(self, job: str, out: Path) -> list[str]:
        """Return the command line of a job."""
        studies = [str(path) for path in sorted((self.folder / "studies").iterdir())]
        settings = ["--scene", str(self.folder / "scene.toml"), "--out", str(out), "--quiet"]
        words = {
            "fit": ["fit", studies[0], "--no-cache", *self.method],
            "report": ["report", studies[0], *self.method],
            "cache": ["fit", studies[0]],
            "batch": ["batch", *studies, "--workers", str(self.workers), *self.method],
        }[job]
        return [sys.executable, "-m", "percept", *words, *settings]

    def start(self, job: str, out: Path) -> subprocess.Popen[bytes]:
        """Start a job in a process group of its own."""
        environment = {**os.environ, "PERCEPT_CACHE": str(out.with_name(f"{out.name}-cache"))}
        return subprocess.Popen(
            self.command(job, out),
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    def finish(self, job: str, out: Path) -> float:
        """Run a job to its end and return how long it took, s."""
        started = time.monotonic()
        process = self.start(job, out)
        _, errors = process.communicate()
        if process.returncode != 0:
            raise AssertionError(f"{job} ended with {process.returncode}: {errors.decode()}")
        return time.monotonic() - started

    def run(self, job: str, kills: int, *, kills_per_run: int = 4) -> int:
        """Kill a job at random moments, and compare what it leaves when taken up again.

        Every so many kills a run is left to finish in the folder that the killed ones wrote into.
        Returns how many runs were compared.

        Raises
        ------
        AssertionError
            A torn file, or other bytes than those of the uninterrupted run.
        """
        whole = self.folder / f"{job}-whole"
        takes = self.finish(job, whole)
        wanted = contents(whole)
        killed = 0
        finished = 0
        while killed < kills:
            out = self.folder / f"{job}-{finished}"
            for _ in range(min(kills_per_run, kills - killed)):
                killed += self._kill(job, out, takes * self._moment())
                self._check_whole(out)
            self.finish(job, out)
            finished += 1
            self._check_whole(out)
            found = contents(out)
            if found != wanted:
                different = sorted(
                    k for k in wanted.keys() | found.keys() if wanted.get(k) != found.get(k)
                )
                raise AssertionError(f"{job}: other bytes after kills in {different}")
            shutil.rmtree(out)
            shutil.rmtree(out.with_name(f"{out.name}-cache"), ignore_errors=True)
        return finished

    def _kill(self, job: str, out: Path, seconds: float) -> bool:
        process = self.start(job, out)
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            # The group too: workers of a batch are processes of their own.
            os.killpg(process.pid, signal.SIGKILL)
        _, errors = process.communicate()
        if process.returncode not in (0, -signal.SIGKILL):
            raise AssertionError(f"{job} ended with {process.returncode}: {errors.decode()}")
        return process.returncode == -signal.SIGKILL

    def _moment(self) -> float:
        """Draw a share of the time a job takes: of all of it, or of the end, where files are
        written."""
        return self.random.uniform(*self.random.choice([(0.0, 1.0), (_WRITING, 1.0)]))

    def _check_whole(self, out: Path) -> None:
        """Read every file under its own name: each must be one that a finished run could have
        written."""
        for path in (*out.rglob("*"), *out.with_name(f"{out.name}-cache").rglob("*")):
            if path.is_file() and ".percept-unfinished-" not in path.as_posix():
                check_whole(path)


def check_whole(path: Path) -> None:
    """Read a file to its end by its kind.

    Raises
    ------
    AssertionError
        Where it is torn.
    """
    data = path.read_bytes()
    try:
        match path.suffix:
            case ".json":
                json.loads(data)
            case ".npz":
                from percept.cache import decode

                decode(data)
            case ".nc":
                import h5py

                with h5py.File(io.BytesIO(data)) as file:
                    file.visititems(
                        lambda _, node: node[()] if isinstance(node, h5py.Dataset) else None
                    )
            case ".html":
                assert data.rstrip().endswith(b"</html>"), "the page has no end"
            case ".svg":
                assert data.rstrip().endswith(b"</svg>"), "the figure has no end"
            case ".jsonl":
                # The next run cuts off a last line that has no end.
                for line in data.decode().split("\n")[:-1]:
                    json.loads(line)
            case _:
                assert data.endswith(b"\n"), "the last line has no end"
    except Exception as error:
        raise AssertionError(f"torn: {path}: {error}") from error


def contents(folder: Path) -> dict[str, str]:
    """Digest every file of a folder but what killed runs left aside, which goes after a day.

    Studies of a batch finish in any order: their lines are digested in that of their keys.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and ".percept-unfinished-" not in path.as_posix():
            data = path.read_bytes()
            if path.suffix == ".jsonl":
                data = b"".join(sorted(data.splitlines(keepends=True)))
            found[path.relative_to(folder).as_posix()] = hashlib.sha256(data).hexdigest()
    return found


def _study(seed: int) -> str:
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(3):
        k, b = 1000 * np.exp(rng.normal(0, 0.15)), 5 * np.exp(rng.normal(0, 0.2))
        rows.append(f"S{subject},VE1,1000,5,{k:.6g},{b:.6g}\n")
    return _HEADER + "".join(rows)
