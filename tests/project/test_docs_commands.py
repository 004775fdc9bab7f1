"""Every command that a page shows is run here as it stands, on a small recording; `ELSEWHERE` says why some are not."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.commands import run
from twistcap.body import Body
from twistcap.camera import Rig
from twistcap.estimate import Estimate
from twistcap.io.calibration import read_rig
from twistcap.io.cameras import write_cameras
from twistcap.io.recording import open_recording
from twistcap.io.result import ResultWriter
from twistcap.io.session import load_session
from twistcap.studio.motion import gait

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / name for name in ("README.md", "CONVENTIONS.md", "CONTRIBUTING.md")]
PAGES += sorted((ROOT / "docs").rglob("*.md"))
FPS, FRAMES = 60.0, 402

QUICK = {
    "studio ": "--frames 3 --size 192x140",
    "track walk/": "--out out/short",
    "new ": "--force",
    "convert ": "--overwrite",
    "body fit ": "--fit-frames 1",
    "refine ": "--set rounds=1 --set coarse_rounds=0 --set points=60",
    "view ": "--save page.html",
}
"""What is added to some commands: fewer frames and rounds, leave to write over, another folder than that of the long
result, and a file in place of a server."""
ELSEWHERE = {
    "README.md: refine ": "a track with its images, as on docs/how-to/refine.md",
    "README.md: body fit ": "the same on docs/how-to/fit-a-body.md",
    "export out/walk/result.h5 --to glb --into": "needs a character of others; tests/io/test_animation.py",
    "export out/walk/result.h5 --to bvh --into": "the same",
    "init ": "waits for clicks; tests/pages/test_init_page.py",
    "body silhouettes": "waits for strokes; tests/pages/test_cut_page.py",
    "body keyviews": "needs four photographs; tests/acquire/test_keyviews.py",
    "body fit walk/session.toml --model anny": "needs torch (1.5 GB)",
    "new walk --calibration Calib.toml --videos videos --detector": "needs a network; tests/io/test_onnx_detector.py",
    "calibrate rig --board board.toml": "needs films of a board; python -m benchmarks.calibration rendered",
    "calibrate rig --board chessboard": "needs photographs; tests/calibrate/test_scene.py",
    "sync ": "needs a second of frames; tests/commands/test_sync.py",
    "refine out/walk/result.h5 --camera": "needs a bumped camera and 24 frames; tests/commands/test_sync.py",
    "refine out/walk/refined/refined.h5 --stature": "needs a fitted body; tests/io/test_projects.py",
    "track walk/session.toml --set": "with what --cameras writes; tests/commands/test_sync.py",
    "study gait.toml --out out/gait --cluster": "needs a Dask cluster; tests/commands/test_study.py",
    "motions build": "needs an ASF file of CMU; tests/motion/test_motion_library.py",
    "motions show": "what motions build wrote; tests/motion/test_motion_library.py",
    "git clone": "the repository that this is",
    "cd twistcap": "the repository that this is",
    "make ": "test_what_is_given_to_make_is_there, and the other jobs of the continuous integration",
    ". .venv/bin/activate": "the environment that runs this",
    ".venv/bin/pre-commit": "changes the clone's hooks",
    "pip install": "changes the environment that runs this",
    "opensim-cmd": "OpenSim's own; tests/io/test_opensim.py runs the same set-ups by its library",
    "ssh ": "another machine",
    "dask ": "serves until it is stopped; tests/commands/test_study.py starts both by their classes",
    "python -m benchmarks": "minutes to hours; tests/reproduce/test_public.py holds that they use public names only",
    "python -m reproduce": "minutes to hours; tests/reproduce/test_command.py, and `reproduce studio --quick` there",
    "JOBS=2 python -m reproduce": "hours",
}


def shown(page: Path) -> list[str]:
    """The lines of a page's shell blocks without comments, and the commands of README's table."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    lines = [re.sub(r"\s*(^| )# .*", "", line) for line in "".join(blocks).splitlines()]
    table = re.findall(r"^\| [^|]+ \| `(twistcap [^`]+)` \|$", text, re.MULTILINE)
    return [line for line in dict.fromkeys([*lines, *table]) if line]


def of_twistcap(page: Path) -> Iterator[str]:
    """Those to run here, without the first word."""
    for line in shown(page):
        if line.startswith("twistcap ") and elsewhere(page, line) is None:
            yield line.removeprefix("twistcap ")


def elsewhere(page: Path, line: str) -> str | None:
    """The key of `ELSEWHERE` under which a line of a page is listed."""
    bare = line.removeprefix("twistcap ")
    return next(
        (start for start in ELSEWHERE if f"{page.name}: {bare}".startswith(start) or bare.startswith(start)), None
    )


def test_each_command_is_run_or_has_its_reason() -> None:
    lines = [(page, line) for page in PAGES for line in shown(page)]
    assert not [line for page, line in lines if not line.startswith("twistcap ") and elsewhere(page, line) is None]
    assert not set(ELSEWHERE) - {elsewhere(page, line) for page, line in lines}
    named = re.findall(r"tests/[\w/]+\.py", " ".join(ELSEWHERE.values()))
    assert named and not [path for path in named if not (ROOT / path).is_file()]
    for page, line in lines:
        [there] = re.findall(r"^the same on (.+)", ELSEWHERE.get(elsewhere(page, line) or "", "")) or [None]
        assert there is None or line.removeprefix("twistcap ") in of_twistcap(ROOT / there), line


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the pages take for granted: a session with its videos, a long result of a walk, and files made of them."""
    folder = tmp_path_factory.mktemp("workshop")
    walk = folder / "walk"
    assert run("studio", walk, "--frames", 3, "--size", "192x140", "--views", 2) == 0
    recording = open_recording(load_session(walk / "session.toml"))
    (folder / "out" / "walk").mkdir(parents=True)
    write_walk(folder / "out" / "walk" / "result.h5", recording.body, recording.views.image_rig)
    for kind, name in (("mot", "angles.mot"), ("trc", "joints.trc"), ("bvh", "walk1.bvh")):
        assert run("export", folder / "out" / "walk" / "result.h5", "--to", kind, "--out", folder / name) == 0
    for name in ("walk1.mot", "walk2.mot"):
        shutil.copy(folder / "angles.mot", folder / name)
    for name in ("direct", "levelset", "jump"):
        shutil.copytree(folder / "out" / "walk", folder / "out" / name)
    for name in ("truth.npz", "masks", "Calib.toml", "videos", "body.glb"):
        copy = shutil.copytree if (walk / name).is_dir() else shutil.copy
        copy(walk / name, folder / name.replace("body", "hero"))
    for source, session in (("walk.toml", "walk"), ("t_pose/session.toml", "../walk")):
        (folder / source).parent.mkdir(exist_ok=True)
        (folder / source).write_text(f'base = "{session}/session.toml"\n')
    assert run("convert", folder / "Calib.toml", folder / "Calib.qca.txt", "--to", "qualisys") == 0
    turn = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # from a world in which -y is up
    lying = Rig(tuple(replace(c, T_cam_world=c.T_cam_world @ turn) for c in read_rig(folder / "Calib.toml")))
    (folder / "opencap").mkdir()
    write_cameras(lying, folder / "opencap" / "Videos", "opencap")
    project = folder / "Pose2Sim_project"
    shutil.copytree(walk / "videos", project / "Trial_1" / "videos")
    (project / "calibration").mkdir()
    shutil.copy(walk / "Calib.toml", project / "calibration")
    quick = 'trials = "trials.csv"\nrefine = false\n[body]\nfit = false\n[output]\nexports = ["mot"]\nreport = false\n'
    (folder / "gait.toml").write_text(quick)
    (folder / "trials.csv").write_text("subject,trial,session\nanna,walk1,walk/session.toml\n")
    norm = ", ".join(f"[{percent}, 0, 60]" for percent in range(101))
    (folder / "Schwartz2008.json").write_text(f'{{"a": {{"Fast": {{"KneeAngles": {{"X": [{norm}]}}}}}}}}')
    return folder


def write_walk(path: Path, body: Body, rig: Rig) -> None:
    with ResultWriter(path, body, rig, {}, room=FRAMES) as writer:
        for n, pose in enumerate(gait(body, fps=FPS, frames=FRAMES)):
            writer.append(Estimate(n, n / FPS, pose, np.eye(body.dof) * 1e-6))


@pytest.mark.parametrize(
    "page", [page for page in PAGES if next(of_twistcap(page), None)], ids=lambda page: str(page.relative_to(ROOT))
)
def test_the_commands_of_a_page_work(
    page: Path, workshop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One after another, in a copy of the workshop; those of getting-started need nothing and get an empty folder. Of
    the study's page the Python that reads its table, too."""
    monkeypatch.chdir(tmp_path)
    if page.name != "getting-started.md":
        shutil.copytree(workshop, tmp_path, dirs_exist_ok=True)
    if page.name == "refine.md":  # it takes a track for granted whose images are there
        assert run("track", "walk/session.toml", "--out", "out/walk", "--overwrite") == 0
    for line in of_twistcap(page):
        more = " ".join(extra for start, extra in QUICK.items() if line.startswith(start) and "--save" not in line)
        here = line.replace("/tmp/", "studio/").replace("new walk ", "new fresh ")
        assert run(*shlex.split(f"{here} {more}")) == 0, line
    if page.name == "study.md" and page.parent.name == "how-to":
        capsys.readouterr()
        [code] = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        exec(code, {})
        assert re.fullmatch(r"anna walk1 -?[\d.]+\n", capsys.readouterr().out)
