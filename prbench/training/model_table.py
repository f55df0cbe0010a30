"""The table ``[model]`` of a configuration: what its keys describe, the networks and what they are trained for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from prbench.errors import UsageError

Networks = TypeVar("Networks", bound=msgspec.Struct)
Objective = TypeVar("Objective", bound=msgspec.Struct)


def split_model_table(
    model: Mapping[str, Any], networks: type[Networks], objective: type[Objective]
) -> tuple[Networks, Objective]:
    """Split the table between two kinds of settings.

    Args:
        model: The table as it is in the TOML file.
        networks: Made from the keys that ``objective`` does not have; should forbid unknown ones.
        objective: Made from the keys of its own.

    Raises:
        UsageError: for an unknown key or an impossible value.
    """
    trained_for = {key: value for key, value in model.items() if key in objective.__struct_fields__}
    described = {key: value for key, value in model.items() if key not in trained_for}
    try:
        return msgspec.convert(described, networks), msgspec.convert(trained_for, objective)
    except msgspec.ValidationError as error:
        raise UsageError(f"[model]: {error}.") from error
