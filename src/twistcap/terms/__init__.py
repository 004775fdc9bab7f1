"""Terms of the one least-squares system: each gives its energy and its quadratic at a pose."""

from twistcap.terms.accumulate import PointTerm, Rows, SegmentSums
from twistcap.terms.coordinates import BlockGaussian, GaussianTerm, LimitTerm, OnPose, RestTerm
from twistcap.terms.photometric import PhotometricTerm
from twistcap.terms.points import KeypointTerm, PointNormalTerm, PointRayTerm
from twistcap.terms.protocols import BlockTerm, MaskableTerm, Place, Quadratic, Slope, Sums, Term
from twistcap.terms.reprojection import ReprojectionTerm

__all__ = [
    "BlockGaussian", "BlockTerm", "GaussianTerm", "KeypointTerm", "LimitTerm", "MaskableTerm", "OnPose",
    "PhotometricTerm", "Place", "PointNormalTerm", "PointRayTerm", "PointTerm", "Quadratic", "ReprojectionTerm",
    "RestTerm", "Rows", "SegmentSums", "Slope", "Sums", "Term",
]  # fmt: skip
