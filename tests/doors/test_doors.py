"""The doors for arrays and result files: what is declared is held against what is there, and no crash comes through."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
import pytest

from support.cameras import ring
from support.results import estimate, two_links
from twistcap.doors import _hdf5_dump, child, hdf5
from twistcap.doors.npz import npz_arrays, read_npz
from twistcap.doors.schema import Schema, checked, real, whole, word
from twistcap.doors.text import finite_number, parsed_toml, read_lines, read_text
from twistcap.errors import InputError, naming
from twistcap.io.result import ResultWriter, read_result

SCHEMA: Schema = {
    "names": word("J"),
    "q": real("N", "J"),
    "cov": real("N", "6+J", "6+J"),
    "up": whole("J", least=-1, below="J"),
}
GOOD: dict[str, Any] = {
    "names": np.array(["a", "b"]),
    "q": np.zeros((3, 2)),
    "cov": np.zeros((3, 8, 8)),
    "up": np.array([-1, 0]),
}


def test_what_fits_comes_in() -> None:
    got = checked(GOOD, SCHEMA, "f", "mend it")
    assert got["names"].tolist() == ["a", "b"] and got["up"].dtype == np.int32 and got["q"].dtype == np.float64


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("q", np.zeros((3, 4)), r"q has shape \(3, 4\), not \(N=3, J=2\)"),
        ("q", np.full((3, 2), np.nan), "q holds a value that is not finite"),
        ("q", np.full((3, 2), 1e9), "q holds a value out of its range"),
        ("q", np.zeros((3, 2), complex), "q holds complex128"),
        ("cov", np.zeros((3, 7, 7)), "cov has shape"),
        ("up", np.array([0, 2]), "up holds a value out of its range, -1 to 1"),
        ("up", np.array([0.0, 1.0]), "up holds float64"),
        ("names", np.array(["a", "b\x1b"]), "names holds a word that is not printable"),
        ("names", np.array([b"\xff\n", b"x"]), "names holds a word that is not printable"),
    ],
)
def test_what_does_not_fit_is_told(name: str, value: Any, told: str) -> None:
    with pytest.raises(InputError, match=f"^file: {told}.*; mend it\\.$"):
        checked(GOOD | {name: value}, SCHEMA, "file", "mend it")
    with pytest.raises(InputError, match=f"{name} is missing"):
        checked({k: v for k, v in GOOD.items() if k != name}, SCHEMA, "file", "mend it")


def packed(raw: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        archive.writestr("a.npy", raw)
    return out.getvalue()


def header(array: Any, **changed: bytes) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    raw = out.getvalue()
    for old, new in changed.items():
        raw = raw.replace(old.encode(), new)
    return raw


def test_an_npz_may_not_declare_more_than_it_holds() -> None:
    whole_one = header(np.arange(3.0))
    assert npz_arrays(packed(whole_one), "f")["a"].tolist() == [0, 1, 2]
    for raw in (whole_one.replace(b"(3,)", b"(4,)"), whole_one.replace(b"(3,)", b"(-1,)"), whole_one[:-1]):
        with pytest.raises(InputError, match="damaged"):
            npz_arrays(packed(raw), "f")
    with pytest.raises(InputError, match="more than a file of its size"):
        npz_arrays(packed(bytes(1 << 28)), "f")
    with pytest.raises(InputError, match="damaged"):
        npz_arrays(packed(whole_one, zipfile.ZIP_LZMA), "f")


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    class Bad:
        def __reduce__(self) -> Any:
            return (Path(tmp_path / "ran").touch, ())

    np.savez(tmp_path / "a.npz", a=np.array([Bad()], dtype=object))
    with pytest.raises(InputError, match="damaged"):
        read_npz(tmp_path / "a.npz", "file", {"a": real("N")})
    assert not (tmp_path / "ran").exists()


def stranger(path: Path) -> Path:
    """A result file that this process has not written."""
    with ResultWriter(path.with_suffix(".own"), two_links(), ring(), {}) as writer:
        writer.append(estimate(0))
    path.write_bytes(path.with_suffix(".own").read_bytes())
    return path


@pytest.mark.parametrize(
    "code", ["import os; os.abort()", "import os; os.kill(os.getpid(), 11)", "raise SystemExit(3)", "while True: pass",
             "import resource; resource.setrlimit(resource.RLIMIT_AS, (1 << 29, 1 << 29)); x = bytes(1 << 34)"],
)  # fmt: skip
def test_a_crash_stays_in_the_child(tmp_path: Path, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = stranger(tmp_path / "r.h5")
    assert len(read_result(path)) == 1
    (tmp_path / "child.py").write_text(code)
    monkeypatch.setattr(_hdf5_dump, "__file__", str(tmp_path / "child.py"))
    monkeypatch.setattr(hdf5, "_SECONDS", 0.2)
    monkeypatch.setattr(child, "_PATIENCE", 10)
    with pytest.raises(InputError, match=r"r\.h5 cannot be read"):
        read_result(path)


def test_a_reader_may_wait_for_the_processor_but_not_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve times its processor time by the clock, as on a busy machine, and without end."""
    np.savez(tmp_path / "a.npz", a=np.arange(3))
    script = tmp_path / "child.py"
    script.write_text("import shutil, sys, time; time.sleep(1.2); shutil.copy(sys.argv[1], sys.argv[2])")
    found = child.arrays_by_child(str(script), tmp_path / "a.npz", "a", seconds=0.1, memory=1 << 30)
    np.testing.assert_array_equal(found["a"], np.arange(3))
    monkeypatch.setattr(child, "_PATIENCE", 1)
    with pytest.raises(InputError, match="a cannot be read: it keeps the reader busy without end"):
        child.arrays_by_child(str(script), tmp_path / "a.npz", "a", seconds=0.1, memory=1 << 30)


def test_our_own_file_needs_no_child_until_it_is_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stranger(tmp_path / "r.h5")
    own = tmp_path / "r.own"
    monkeypatch.setattr(_hdf5_dump, "__file__", str(tmp_path / "none.py"))
    assert len(read_result(own)) == 1
    own.write_bytes(own.read_bytes() + b" ")
    with pytest.raises(InputError, match="cannot be read"):
        read_result(own)


@pytest.mark.parametrize("value", ["nan", "1e999", "1_0", "x", True, None, [1], 10**400, "９" * 5000])
def test_numbers_in_text(value: Any) -> None:
    with pytest.raises(InputError, match=r"^where"):
        finite_number(value, "where")


def test_text_has_a_size_and_a_kind(tmp_path: Path) -> None:
    (tmp_path / "a.gz").write_bytes(b"\x1f\x8b no gzip")
    (tmp_path / "b").write_bytes(b"\xff\xff")
    for name in ("a.gz", "b", "missing", ".", "x\0y"):
        with pytest.raises(InputError, match=r"cannot be|not a text"):
            read_text(tmp_path / name)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_text_says_how_it_is_encoded(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.csv").write_text("Hüfte,1\n", encoding)
    assert read_text(tmp_path / "a.csv") == "Hüfte,1\n" and read_lines(tmp_path / "a.csv") == ["Hüfte,1"]
    (tmp_path / "a.csv").write_text("Hüfte,1\n", "cp1252")
    with pytest.raises(InputError, match="not a text file in UTF-8; save it with that encoding"):
        read_text(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("text", "mend"),
    [
        ("a = foo", "write texts in quotes"),
        ('a = "C:\\videos"', "write / for"),
        ('a = "C:\\Users\\me"', "write / for"),
        ('a = "x', "with the quote that it began with"),
        ("a = .5", "0.5 for .5"),
        ("a = 1,5", "1.5 for 1,5"),
        ("a = 1\na = 2", "may stand once"),
        ("my key = 3", "write key = value"),
        ("a = [1", "mend it there"),
    ],
)
def test_toml_says_how_it_is_mended(text: str, mend: str) -> None:
    with pytest.raises(InputError, match=f"s.toml is not valid TOML: .*{mend}"):
        parsed_toml(text, "s.toml")


def test_sentences_are_short_and_harmless() -> None:
    with pytest.raises(InputError) as caught, naming("/a/file"):
        raise InputError(f"the name {'x' * 5000}\x1b[2J\n is unknown; take another.")
    text = str(caught.value)
    assert len(text) < 300 and text.isprintable() and text.startswith("/a/file") and text.endswith("take another.")


def test_a_long_path_gives_way_to_the_sentence() -> None:
    folder = "/a" * 100
    told = "the first pose is of another frame than the recording's first one; find it again, or give its own frame."
    with pytest.raises(InputError) as caught, naming(f"{folder}/first.json"):
        raise InputError(f"{folder}/first.json and {folder}/session.toml: {told}")
    text = str(caught.value)
    assert text.startswith("…") and text.endswith(f"/a/a/session.toml: {told}") and len(text) < 300
    assert text.count("first.json") == 1 and "/a/a/first.json and" in text


def test_what_is_read_is_in_memory_but_once(tmp_path: Path) -> None:
    """Of a file of somebody else: neither its bytes nor its arrays are copied."""
    values = np.arange(1 << 21, dtype=float)
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["values"] = values
    hdf5.read_hdf5(tmp_path / "r.h5")
    tracemalloc.start()
    found = hdf5.read_hdf5(tmp_path / "r.h5")["values"]
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1.3 * values.nbytes
    np.testing.assert_array_equal(found, values)
    assert found.flags.writeable and found.flags.aligned


@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_of_any_order_come_in_rows(order: Literal["C", "F"]) -> None:
    values, file = np.asarray(np.arange(24.0).reshape(2, 3, 4), order=order), io.BytesIO()
    np.savez_compressed(file, values=values, one=np.array(3), none=np.zeros((0, 3)))
    found = npz_arrays(file.getvalue(), "it")
    np.testing.assert_array_equal(found["values"], values)
    assert found["values"].flags.c_contiguous and found["one"].shape == () and found["none"].shape == (0, 3)
