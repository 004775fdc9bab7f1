"""One writer for each result file: a lock beside it, which the kernel gives back when its holder dies."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from twistcap.errors import InputError


class WriteLock:
    """The right to write one file, across processes. Use as a context manager."""

    def __init__(self, path: str | Path) -> None:
        """Take it; the folder must exist. Raises InputError where another has it, or where no lock can be made."""
        self.path = Path(path)
        self._file = self.path.with_name(f".{self.path.name}.lock")
        try:
            while (taken := self._taken()) is None:
                pass
        except FileNotFoundError as error:
            raise InputError(f"{path} cannot be written: its folder does not exist; check its path.") from error
        except BlockingIOError as error:
            mend = "wait until it ends, or choose another folder"
            raise InputError(f"{path} is being written by another process{self._holder()}; {mend}.") from error
        except OSError as error:
            raise InputError(f"{path} cannot be written: {error.strerror}; choose another folder.") from error
        self._descriptor: int | None = taken
        with suppress(OSError):  # a full disk holds the lock, if not the number of its holder
            os.ftruncate(taken, 0)
            os.write(taken, str(os.getpid()).encode())

    def _taken(self) -> int | None:
        """The locked file; None if its holder has just removed it."""
        descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(descriptor), os.stat(self._file)):
                return descriptor
        except FileNotFoundError:
            pass
        except OSError:
            os.close(descriptor)
            raise
        os.close(descriptor)
        return None

    def _holder(self) -> str:
        with suppress(OSError):
            number = self._file.read_text(encoding="ascii", errors="replace")
            return f" ({number})" if number.isdigit() else ""
        return ""

    def release(self) -> None:
        """Give it back; safe to call twice."""
        if self._descriptor is not None:
            self._file.unlink(missing_ok=True)  # first: who opens it now finds that it is gone, and makes another
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> WriteLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
