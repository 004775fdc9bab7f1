"""The humanoid's surface as the wheel carries it is the one that its cross-sections give."""

from __future__ import annotations

from importlib import resources

import numpy as np
import pytest

from reproduce.humanoid.surface import modelled


@pytest.mark.parametrize("variant", ["full", "legs"])
def test_the_stored_surface_is_the_modelled_one(variant: str) -> None:
    with (resources.files("twistcap.body") / "humanoid.npz").open("rb") as file:
        stored = {name: values for name, values in np.load(file).items() if name.startswith(variant)}
    made = modelled(variant)
    assert stored.keys() == made.keys()
    for name, values in made.items():
        np.testing.assert_allclose(stored[name], values, atol=1e-9)
