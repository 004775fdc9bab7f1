"""Results against references: error measures, and `evaluate` for every kind of reference."""

from twistcap.evaluate.load import Reference
from twistcap.evaluate.metrics import Row, row
from twistcap.evaluate.reference import Evaluation, compare, evaluate

__all__ = ["Evaluation", "Reference", "Row", "compare", "evaluate", "row"]
