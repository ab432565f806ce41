"""The stand-in's parameters."""

from __future__ import annotations

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue

FIELDS = {1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value"}
FIELDS |= {8: "double_array_value", 9: "string_array_value"}


def _type(value: object) -> int:
    if value is None:
        return 0
    if isinstance(value, (list, tuple)):
        return 9 if all(isinstance(item, str) for item in value) else 8
    return {bool: 1, int: 2, float: 3, str: 4}[type(value)]


class Parameter:
    def __init__(self, name: str, *, value: object) -> None:
        self.name = name
        self.value = value
        self.type_ = _type(value)

    def message(self) -> ParameterMessage:
        found = ParameterValue(type=self.type_)
        if self.type_:
            setattr(found, FIELDS[self.type_], self.value)
        return ParameterMessage(name=self.name, value=found)


def value_of(message: ParameterValue) -> object:
    return getattr(message, FIELDS[message.type]) if message.type else None
