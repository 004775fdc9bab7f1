"""Terms of the one least-squares system: each gives its energy and its quadratic at a pose."""

from twistcap.terms.accumulate import PointTerm, SegmentSums
from twistcap.terms.coordinates import GaussianTerm, LimitTerm, RestTerm
from twistcap.terms.photometric import PhotometricTerm
from twistcap.terms.points import KeypointTerm, PointNormalTerm, PointRayTerm
from twistcap.terms.quadratic import MaskableTerm, Quadratic, Term

__all__ = [
    "GaussianTerm",
    "KeypointTerm",
    "LimitTerm",
    "MaskableTerm",
    "PhotometricTerm",
    "PointNormalTerm",
    "PointRayTerm",
    "PointTerm",
    "Quadratic",
    "RestTerm",
    "SegmentSums",
    "Term",
]
