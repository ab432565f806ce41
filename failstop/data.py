"""Data: small classes for plain values, like those of `dataclasses`. Importing `dataclasses` would cost each process 36
ms and 2.3 MB."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from typing_extensions import dataclass_transform
else:

    def dataclass_transform():
        return lambda cls: cls


@dataclass_transform()
class Data:
    """A base class for classes that only hold values. The annotated names of a subclass are its fields, in that order.
    Give each value by position or by name. A field with a default may be left out. Raises TypeError if a value is
    missing, is given twice, or has no field."""

    def __init__(self, *values: Any, **named: Any) -> None:
        fields = type(self).__annotations__
        for name, value in zip(fields, values, strict=False):
            setattr(self, name, value)
        for name, value in named.items():
            setattr(self, name, value)
        if named or len(values) < len(fields):
            self._check(values, named)
        elif len(values) > len(fields):
            raise TypeError(f"{type(self).__name__} has {len(fields)} fields, and {len(values)} were given")

    def _check(self, values: tuple[Any, ...], named: dict[str, Any]) -> None:
        """Raise TypeError if a field without a default has no value, a field has two values, or a name is not a
        field."""
        fields = tuple(type(self).__annotations__)
        by_place, rest = fields[: len(values)], fields[len(values) :]
        missing = [name for name in rest if name not in named and not hasattr(type(self), name)]
        unknown = [name for name in named if name not in fields]
        twice = [name for name in by_place if name in named]
        for what, names in (("has no field", unknown), ("has two values for", twice), ("lacks", missing)):
            if names:
                raise TypeError(f"{type(self).__name__} {what} {', '.join(names)}")
