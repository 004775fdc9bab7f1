"""A pair of a real recording's cameras, judged in all of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from reproduce.experiments.real_recording import EXAMPLES, PAIRS, against_reference, tracked


def test_a_pair_is_judged_in_all_four_cameras(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TWISTCAP_DATA", str(shared_data))
    path = tmp_path / "result.h5"
    tracked(EXAMPLES / "balance_4view.toml", {**PAIRS["cam01+cam02"], "frames": (0, 4)}, path)
    found = {row["metric"]: row["value"] for row in against_reference("pair", path)}
    assert found["frames"] == 5
    assert found["lost"] == 0 and 0.0 < float(found["joints"] or 0.0) < 60.0
    assert float(found["IoU"] or 0.0) > 0.8
