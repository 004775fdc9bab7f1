"""The first pose from the images alone: no keypoints, no clicks, no network."""

from twistcap.adjust.unaided.hull import middle_of_sight
from twistcap.adjust.unaided.proof import Proof, ProofRule, Unaided
from twistcap.adjust.unaided.scenery import Scenery, scenery_of
from twistcap.adjust.unaided.search import Candidate, Instant, UnaidedRule
from twistcap.search.stances import STANCES, bundled, turned_round

__all__ = [
    "STANCES", "Candidate", "Instant", "Proof", "ProofRule", "Scenery", "Unaided", "UnaidedRule", "bundled",
    "middle_of_sight", "scenery_of", "turned_round",
]  # fmt: skip
