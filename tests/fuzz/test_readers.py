"""Damaged files through every reader, a few of each; ``python -m tests.fuzz --budget N`` takes as many as one likes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.hunt import hunt
from tests.fuzz.targets import targets
from twistcap.body.gltf import load_glb
from twistcap.doors.images import read_image
from twistcap.doors.npz import npz_arrays
from twistcap.doors.text import parsed_json, parsed_toml
from twistcap.errors import InputError
from twistcap.io.asf import read_asf
from twistcap.io.result import read_result

BUDGET = 700


def test_damaged_files_are_read_or_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "seeds").mkdir()
    faults = hunt(targets(tmp_path / "seeds"), BUDGET, 7, tmp_path, print)
    assert not faults, "\n".join(map(str, faults))


def test_the_whole_files_are_read(tmp_path: Path) -> None:
    """A fuzzer whose files are refused from the start finds nothing."""
    refused: list[str] = []
    for name, target in targets(tmp_path).items():
        try:
            target.read(target.seed)
        except InputError as error:
            refused.append(f"{name}: {error}")
    assert not refused


# ---- what the fuzzers found ----


def test_a_chunk_of_a_png_that_is_longer_than_the_file(tmp_path: Path) -> None:
    targets(tmp_path)
    data = bytearray((tmp_path / "0001.png").read_bytes())
    data[33:37] = (0x7FFFFFFF).to_bytes(4, "big")
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(InputError, match=r"a\.png is corrupt"):
        read_image(tmp_path / "a.png", "image")


def test_a_bone_that_hangs_on_itself(tmp_path: Path) -> None:
    targets(tmp_path)
    text = (tmp_path / "a.asf").read_text().replace("root upper", "root upper\n    upper upper")
    (tmp_path / "a.asf").write_text(text)
    with pytest.raises(InputError, match="hangs on itself"):
        read_asf(tmp_path / "a.asf")


def test_an_asf_without_a_unit(tmp_path: Path) -> None:
    targets(tmp_path)
    (tmp_path / "a.asf").write_text((tmp_path / "a.asf").read_text().replace("length 0.45", "length 0"))
    with pytest.raises(InputError, match="length in :units is 0"):
        read_asf(tmp_path / "a.asf")


def test_a_header_of_an_array_that_is_no_python(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.zeros(3))
    data = (tmp_path / "a.npz").read_bytes().replace(b"'shape': (3,), }", b"'shape': ((((((( ")
    with pytest.raises(InputError, match="damaged"):
        npz_arrays(data, "a.npz")


@pytest.mark.parametrize(
    "text",
    ["[" * 5000, '{"a": 1e999}', '{"a": NaN}', '{"a": 1, "a": 2}', '{"a": ' + "9" * 5000 + "}", "[" * 50 + "]" * 50],
)
def test_json_without_bounds(text: str) -> None:
    with pytest.raises(InputError, match=r"x\.json") as caught:
        parsed_json(text, "x.json")
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 5000, "a = nan", "a = -inf", "a = " + "9" * 40, "a = 1\na = 2", "a = " + "9" * 5000]
)
def test_toml_without_bounds(text: str) -> None:
    with pytest.raises(InputError, match=r"x\.toml") as caught:
        parsed_toml(text, "x.toml")
    assert len(str(caught.value)) < 300


def test_a_glb_does_not_read_other_folders(tmp_path: Path) -> None:
    targets(tmp_path)
    import json

    data = (tmp_path / "body.glb").read_bytes()
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    (tmp_path / "below").mkdir()
    for uri in ("../body.glb", str(tmp_path / "body.glb"), "..%2Fbody.glb", "", "no.bin"):
        content["buffers"][0]["uri"] = uri
        (tmp_path / "below" / "a.gltf").write_text(json.dumps(content))
        with pytest.raises(InputError, match="no file beside it"):
            load_glb(tmp_path / "below" / "a.gltf")


def test_a_result_may_lead_nowhere_else(tmp_path: Path) -> None:
    """Links out, data stored outside and sizes that no file holds are refused by the child."""
    import shutil

    import h5py

    whole = targets(tmp_path)["result"].seed
    forged = {
        "is a link to elsewhere": lambda f: f.__setitem__("a", h5py.ExternalLink("/etc/passwd", "/")),
        "is stored in another file": lambda f: f.create_dataset("a", (8,), "u1", external=[("/etc/hostname", 0, 8)]),
        "larger than a file of its size": lambda f: f.create_dataset("a", (1 << 40,), "f8", chunks=(64,)),
        "is of the type": lambda f: f.create_dataset("a", (2,), h5py.ref_dtype),
        "more groups": lambda f: [f.create_group(f"g{k}") for k in range(2500)],
    }
    for number, (told, forge) in enumerate(forged.items()):
        path = tmp_path / f"{number}.h5"
        shutil.copyfile(whole, path)
        with h5py.File(path, "r+") as file:
            forge(file)
        with pytest.raises(InputError, match=rf"{number}\.h5.*{told}"):
            read_result(path)


def test_a_root_of_deepmimic_with_a_parent(tmp_path: Path) -> None:
    """The first joint is the root, whatever its parent is said to be."""
    seeds = targets(tmp_path)
    skeleton = tmp_path / "skeleton.json"
    skeleton.write_text(skeleton.read_text().replace('"Parent": -1', '"Parent": 2147483648'))
    assert seeds["deepmimic skeleton"].read(skeleton).parents[0] == -1


def test_a_reference_with_an_angle_that_is_not_known(tmp_path: Path) -> None:
    """Its row is not known; a file without any other is refused."""
    seeds = targets(tmp_path)
    lines = (tmp_path / "walk.mot").read_text().splitlines()
    gaps = [line.rpartition("\t")[0] + "\tnan" for line in lines[-3:]]
    (tmp_path / "walk.mot").write_text("\n".join([*lines[:-1], gaps[-1]]))
    angles = seeds["mot reference"].read(tmp_path / "walk.mot").angles
    assert np.isnan(angles).all(axis=1).tolist() == np.isnan(angles).any(axis=1).tolist() == [False, False, True]
    (tmp_path / "walk.mot").write_text("\n".join([*lines[:-3], *gaps]))
    with pytest.raises(InputError, match=r"walk\.mot.*NaN"):
        seeds["mot reference"].read(tmp_path / "walk.mot")


def test_durations_of_deepmimic_that_no_clock_can_add(tmp_path: Path) -> None:
    seeds = targets(tmp_path)
    clip = tmp_path / "clip.json"
    for duration in ("1e-300", "1e300", "0", "-1", "9999"):
        clip.write_text(seeds["deepmimic"].seed.read_text().replace("[[0.1,", f"[[{duration},", 1))
        with pytest.raises(InputError, match=r"clip\.json: .*duration"):
            seeds["deepmimic"].read(clip)
        targets(tmp_path)
