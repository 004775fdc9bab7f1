"""A child process that reads a stranger's file with a library in C, which a forged file can crash or keep busy."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from twistcap.arrays import AnyArray
from twistcap.doors.npz import npz_arrays
from twistcap.errors import InputError

_PATIENCE = 60  # times the processor time: on a busy machine a child waits far longer than it works


def arrays_by_child(script: str, path: Path, source: str, seconds: float, memory: int) -> dict[str, AnyArray]:
    """What a script, called as ``script FILE OUT.npz SECONDS BYTES``, writes of a file.

    It may take so many seconds of processor time and bytes of memory. Raises InputError where it fails; `source` is the
    file, for messages.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "arrays.npz"
        command = [sys.executable, "-P", script, str(path.resolve()), str(out), str(seconds), str(memory)]
        limits = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "HDF5_PLUGIN_PRELOAD": "::"}
        environment = {key: value for key, value in os.environ.items() if not key.startswith("HDF5_")} | limits
        try:
            done = subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace",
                timeout=_PATIENCE * seconds, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise InputError(f"{source} cannot be read: it keeps the reader busy without end.") from error
        if done.returncode:
            why = done.stderr.strip().splitlines()[-1:] if done.returncode == 2 else ["it is damaged"]
            raise InputError(f"{source} cannot be read: {''.join(why) or 'it is damaged'}.")
        return npz_arrays(out, source)
