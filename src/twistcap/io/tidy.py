"""Tidy tables: one value a row. Trials write their own rows; the table of a study is these, one after another."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twistcap.arrays import Float
from twistcap.errors import InputError
from twistcap.io.files import replacing
from twistcap.io.result import Result

FRAME = ("subject", "trial", "frame", "time", "coordinate", "unit", "value", "sigma", "flag")
CYCLE = ("subject", "trial", "side", "stride", "percent", "coordinate", "unit", "value", "sigma", "flag")
_WORDS = ("subject", "trial", "side", "coordinate", "unit", "flag")
_BLOCK = 16 << 20  # bytes of CSV that are turned into Parquet at a time


def flags(result: Result) -> list[str]:
    """A word for each of N frames: "ok", "lost", or the status of a frame in which the body was not seen."""
    words = zip(result.statuses, result.lost, result.known, strict=True)
    return ["ok" if known else "lost" if lost else status for status, lost, known in words]


def cells(values: Float, sigmas: Float) -> list[tuple[str, str]]:
    """Value and standard deviation (N,) as text; empty where they are not known."""
    return [(_number(v), _number(s)) for v, s in zip(values, sigmas, strict=True)]


def _number(value: float) -> str:
    return f"{value:.6f}" if np.isfinite(value) else ""


def write_rows(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]], end: str = "\n") -> Path:
    """A CSV with a head and the `end` of its lines; its path. Raises InputError where it cannot be written."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator=end)
        writer.writerow(head)
        writer.writerows(rows)
    return path


def join(path: Path, head: Sequence[str], parts: Iterable[Path]) -> None:
    """The rows of CSV files of the same head, in one. Raises InputError for one whose head is another."""
    first = (",".join(head) + "\n").encode()
    with replacing(path) as whole, whole.open("wb") as out:
        out.write(first)
        for part in parts:
            with part.open("rb") as file:
                if file.readline() != first:
                    raise InputError(f"{part} has other columns than {path.name}; make it again with --overwrite.")
                shutil.copyfileobj(file, out, 1 << 20)


def to_parquet(table: Path) -> Path:
    """A CSV of `join` as Parquet beside it, block by block. Raises InputError where it cannot be written."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv
    from pyarrow import parquet

    words = dict.fromkeys(_WORDS, pa.dictionary(pa.int32(), pa.string()))
    numbers = {"frame": pa.int64(), "stride": pa.int64(), "percent": pa.float64(), "time": pa.float64()}
    kinds = words | numbers | {"value": pa.float64(), "sigma": pa.float64()}
    read = arrow_csv.ReadOptions(block_size=_BLOCK)
    reader = arrow_csv.open_csv(table, read, convert_options=arrow_csv.ConvertOptions(column_types=kinds))
    path = table.with_suffix(".parquet")
    with replacing(path) as part, parquet.ParquetWriter(part, reader.schema, compression="zstd") as writer:
        for batch in reader:
            writer.write_batch(batch)
    return path
