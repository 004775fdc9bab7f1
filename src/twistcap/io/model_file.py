"""Files of pose networks that a user names: by path, or by web address with a checksum, kept in the user's cache.

A name is ``net.onnx``, ``net.zip`` (with one ONNX file in it) or ``https://…/net.zip``; ``#sha256=HEX`` at its end is
the checksum of that file, as pip writes it.
"""

from __future__ import annotations

import hashlib
import io
import lzma
import os
import re
import urllib.request
import zipfile
import zlib
from http.client import HTTPException
from pathlib import Path

from twistcap.doors.text import read_bytes
from twistcap.errors import InputError
from twistcap.io.files import replacing

LARGEST = 1 << 30  # bytes of a model
_WAIT = 30.0  # s for an answer
_DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, UnicodeDecodeError)  # the last by a name in the archive


def is_model_file(name: str) -> bool:
    """Whether a name is that of a file or an address, and not that of an installed detector."""
    return _split(name)[0].lower().endswith((".onnx", ".zip"))


def is_address(name: str) -> bool:
    """Whether a name leads to the web."""
    return name.lower().startswith(("https://", "http://"))


def check_there(name: str) -> None:
    """Raises InputError where a name is that of a file that does not exist."""
    where = _split(name)[0]
    if is_model_file(where) and not is_address(where) and not Path(where).expanduser().exists():
        raise InputError(f"model {where} does not exist; check the path that is given as detector or people.")


def model_bytes(name: str) -> bytes:
    """The ONNX file of a name.

    Raises InputError where the file is missing, cannot be fetched or stored, has another checksum than the name says,
    or is a ZIP file without one ONNX file; and for an address without checksum: the sentence says which the file has.
    """
    where, checksum = _split(name)
    check_there(where)
    data = _fetched(where, checksum) if is_address(where) else read_bytes(Path(where).expanduser(), LARGEST)
    if checksum is not None and _sha256(data) != checksum:
        raise InputError(f"model {where} has the checksum {_sha256(data)}, not {checksum}; get the file again.")
    return _unzipped(data, where) if where.lower().endswith(".zip") else data


def cache_folder() -> Path:
    """Where fetched models are kept."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "twistcap" / "models"


def _split(name: str) -> tuple[str, str | None]:
    found = re.fullmatch(r"(.*)#sha256=([0-9a-fA-F]{64})", name)
    if found is None and "#" in name:
        raise InputError(f"model {name}: after # stands sha256= and 64 hexadecimal digits.")
    return (name, None) if found is None else (found[1], found[2].lower())


def _fetched(address: str, checksum: str | None) -> bytes:
    """From the cache if it is there; fetched files are kept under their checksum."""
    kept = cache_folder() / str(checksum)
    if checksum is not None and kept.is_file():
        data = read_bytes(kept, LARGEST)
        if _sha256(data) == checksum:
            return data
    data = _download(address)
    if checksum is None:
        mend = f"if you trust it, write {address}#sha256={_sha256(data)}"
        raise InputError(f"model {address} is named without its checksum; {mend}.")
    if _sha256(data) == checksum:
        _keep(kept, data)
    return data


def _download(address: str) -> bytes:
    try:
        request = urllib.request.Request(address, headers={"User-Agent": "twistcap"})
        with urllib.request.urlopen(request, timeout=_WAIT) as answer:
            data = answer.read(LARGEST + 1)
    except (OSError, HTTPException, ValueError) as error:  # ValueError: no address
        mend = "fetch it by hand and give its path"
        raise InputError(f"model {address} cannot be fetched ({getattr(error, 'reason', error)}); {mend}.") from error
    if len(data) > LARGEST:
        raise InputError(f"model {address} is larger than {LARGEST >> 20} MB; no pose network is.")
    return data


def _keep(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"model cache {path.parent} cannot be made: {error.strerror}; set XDG_CACHE_HOME.") from error
    with replacing(path, "model") as part:
        Path(part).write_bytes(data)


def _unzipped(data: bytes, where: str) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            inside = [i for i in archive.infolist() if i.filename.lower().endswith(".onnx")]
            if len(inside) != 1 or inside[0].file_size > LARGEST:
                raise InputError(f"model {where} holds {len(inside)} ONNX files; unpack it and name one.")
            return archive.read(inside[0])
    except (*_DAMAGED, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise InputError(f"model {where} cannot be unpacked ({error}); get the file again.") from error


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
