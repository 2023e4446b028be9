"""Messages of one topic as named arrays."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
AXES = {"ned": "ned", "frd": "frd", "body": "frd"}
"""Names of the axes of a vector, by the frame in the field's name."""


@dataclass(frozen=True)
class Table:
    """The messages of one topic; `table["pos_uav_ned_m"]` is the array of one field.

    Attributes:
        topic: name of the topic.
        columns: (n, ...) values by the field's name; a nested field is `outer.inner`. Values that are no numbers, or
            that have different lengths, are an array of objects.
    """

    topic: str
    columns: dict[str, Array]

    def __getitem__(self, field: str) -> Array:
        return self.columns[field]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def flat(self) -> Iterator[tuple[str, Array]]:
        """(name, (n,) values) of each component: `vel_uav_ned_mps.n` is the component to the north."""
        for name, values in self.columns.items():
            if values.ndim == 1:
                yield name, values
                continue
            rows = values.reshape(len(values), -1)
            for index, axis in enumerate(_axes(name, rows.shape[1])):
                yield f"{name}.{axis}", rows[:, index]

    def to_pandas(self) -> Any:
        """A pandas DataFrame of all components.

        Raises:
            ModuleNotFoundError: pandas is not installed.
        """
        try:
            import pandas as pd
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError("a data frame needs pandas: pip install pandas", name=error.name) from None
        return pd.DataFrame(dict(self.flat()))


def make_table(topic: str, logged_ns: Sequence[int], messages: Sequence[Any]) -> Table:
    """The table of messages of one type, with their times of arrival in the column `logged_ns`."""
    columns: dict[str, Array] = {"logged_ns": np.array(logged_ns, dtype=np.int64)}
    columns.update(_columns("", messages))
    return Table(topic, columns)


def _columns(prefix: str, messages: Sequence[Any]) -> Iterator[tuple[str, Array]]:
    """Columns of structs of one type; None stands for a struct that is missing."""
    first = next(message for message in messages if message is not None)
    for field in first.__struct_fields__:
        values = [None if message is None else getattr(message, field) for message in messages]
        kinds = {type(value) for value in values if value is not None}
        if len(kinds) == 1 and all(issubclass(kind, msgspec.Struct) for kind in kinds):
            yield from _columns(f"{prefix}{field}.", values)
        else:
            yield f"{prefix}{field}", _column(values)


def _column(values: Sequence[Any]) -> Array:
    """Numbers and vectors as numbers, with NaN for None; everything else as objects."""
    vector = next((value for value in values if isinstance(value, tuple)), None)
    missing = np.nan if vector is None else (np.nan,) * len(vector)
    try:
        array = np.array([missing if value is None else value for value in values])
    except (ValueError, TypeError):  # of different lengths, or of structs
        array = np.array([], dtype=object)
    if array.dtype.kind in "biuf" and len(array) == len(values) and array.size:
        return array
    objects = np.empty(len(values), dtype=object)
    objects[:] = values
    return objects


def _axes(name: str, count: int) -> Sequence[str]:
    """Names of the components of a field, from the frame in its name; their numbers where it names none."""
    field = name.rpartition(".")[2]
    if field.startswith("q_") and count == 4:
        return "wxyz"
    if count <= 3:
        for word in reversed(field.split("_")):
            if word in AXES:
                return AXES[word][:count]
    return [str(index) for index in range(count)]
