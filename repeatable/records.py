"""Flower's records as arrays and JSON, which come back as they were, and models' digests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from flwr.app import Array, ArrayRecord, ConfigRecord, MetricRecord, RecordDict
from numpy.typing import NDArray

from storage.checkpoint_files import Arrays, Json, arrays_digest

_PLAIN = {"metrics": MetricRecord, "config": ConfigRecord}


def digest(arrays: ArrayRecord | Mapping[str, NDArray[np.generic]]) -> str:
    """SHA-256 of a model, 64 hexadecimal digits: the same where two are the same to the bit.

    Names, types, shapes and values count, and not their order.
    """
    if isinstance(arrays, ArrayRecord):
        arrays = {name: array.numpy() for name, array in arrays.items()}
    return arrays_digest(arrays)


def packed(records: RecordDict) -> tuple[Arrays, list[Json]]:
    """Records as arrays by name, and what JSON holds of them."""
    arrays: Arrays = {}
    described: list[Json] = []
    for number, (name, record) in enumerate(records.items()):
        entry: dict[str, Json] = {"name": name}
        if isinstance(record, ArrayRecord):
            entry["arrays"] = list(record)
            arrays |= {f"{number}/{name}/{key}": array.numpy() for key, array in record.items()}
        else:
            kind = "metrics" if isinstance(record, MetricRecord) else "config"
            entry[kind] = [[key, _to_json(value)] for key, value in record.items()]
        described.append(entry)
    return arrays, described


def unpacked(arrays: Mapping[str, NDArray[np.generic]], described: Any) -> RecordDict:
    """The inverse of ``packed``."""
    records = RecordDict()
    for number, entry in enumerate(described):
        name = entry["name"]
        if "arrays" in entry:
            keys = entry["arrays"]
            found = {key: Array(np.asarray(arrays[f"{number}/{name}/{key}"])) for key in keys}
            records[name] = ArrayRecord(found)
        else:
            kind = next(kind for kind in _PLAIN if kind in entry)
            records[name] = _PLAIN[kind]({key: _of_json(value) for key, value in entry[kind]})
    return records


def _to_json(value: Any) -> Json:
    if isinstance(value, list):
        return [_to_json(each) for each in value]
    if isinstance(value, bytes):
        return {"bytes": value.hex()}
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": str(value)}
    return value  # type: ignore[no-any-return]  # records hold nothing else


def _of_json(value: Any) -> Any:
    if isinstance(value, list):
        return [_of_json(each) for each in value]
    if isinstance(value, dict):
        return float(value["float"]) if "float" in value else bytes.fromhex(value["bytes"])
    return value
