"""Services of a driver that are called by configuration: before the first motion, and as a stage of the stop.

Written as `name=package/srv/Type` or `name=package/srv/Type{field: value, ...}` (YAML), for example

    /start_traj_mode=motoros2_interfaces/srv/StartTrajMode
    /fanuc_gpio_controller/switch_control_state=fanuc_msgs/srv/SwitchControlState{status: 1}
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import yaml

from calibration.topics import load_type
from calibration_core.errors import InputError, quoted


@dataclasses.dataclass(frozen=True)
class Call:
    """One service call.

    Attributes:
        name: Of the service.
        type: `package/srv/Type`.
        fields: Of the request; the others keep their defaults.
    """

    name: str
    type: str
    fields: Mapping[str, Any]

    def request(self) -> Any:
        """Return the request.

        Raises:
            InputError: The package is not installed, or the type has no such field.
        """
        kind = load_type(self.type).Request
        try:
            return kind(check_fields=True, **self.fields)
        except (AssertionError, TypeError):
            known = ", ".join(f"{name} ({of})" for name, of in kind.get_fields_and_field_types().items())
            raise InputError(
                "parameters", self.name, quoted(dict(self.fields)), f"fields of {known or 'none'}"
            ) from None


def parse_call(text: str) -> Call:
    """Read one entry.

    Raises:
        InputError: It is malformed.
    """
    name, separator, rest = text.partition("=")
    kind, brace, fields = rest.partition("{")
    expected = "name=package/srv/Type{field: value}"
    if not separator or not name.strip() or "/srv/" not in kind:
        raise InputError("parameters", "services", quoted(text), expected)
    try:
        values = yaml.safe_load(brace + fields) if brace else {}
    except yaml.YAMLError:
        raise InputError("parameters", "services", quoted(text), expected) from None
    if not isinstance(values, dict):
        raise InputError("parameters", "services", quoted(text), expected)
    return Call(name.strip(), kind.strip(), values)


def succeeded(response: Any) -> tuple[bool, str]:
    """Tell whether a service's answer is a success, by the fields that drivers use, and its words."""
    text = str(getattr(response, "message", ""))
    flag = getattr(response, "success", None)
    if isinstance(flag, bool):
        return flag, text
    code = getattr(response, "result_code", None)
    value = getattr(code, "value", code)
    if isinstance(value, int):
        return value in {0, 1}, text or f"result code {value}"  # MotoROS2: 1 is ready, 0 is nothing to say
    return True, text


def callers(node: Any, parameter: str) -> list[tuple[Any, Any]]:
    """Return client and request of every call that a node's parameter names.

    Raises:
        InputError: A call cannot be understood, or its package is not installed.
    """
    calls = [parse_call(text) for text in node.value(parameter)]
    return [(node.create_client(load_type(call.type), call.name), call.request()) for call in calls]
