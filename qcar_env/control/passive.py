"""No control: ``u_i = 0``, the paper's uncontrolled system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from qcar_env.control.law import Law


@dataclass(frozen=True, kw_only=True)
class Passive(Law):
    """No control."""

    name = "none"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``(0, 0)`` [m/s^2] in the state's own kind."""
        return 0.0 * x.v1, 0.0 * x.v2
