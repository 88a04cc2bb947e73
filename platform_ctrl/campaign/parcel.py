"""A plan as bytes, for workers: `control.StateSpace` itself cannot be pickled."""

from __future__ import annotations

import io
import pickle
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import control

    from platform_ctrl.campaign.plan import Plan


def packed(plan: Plan) -> bytes:
    """Return the plan as bytes."""
    out = io.BytesIO()
    _Pickler(out, protocol=pickle.HIGHEST_PROTOCOL).dump(plan)
    return out.getvalue()


def unpacked(parcel: bytes) -> Plan:
    """Return the plan that was packed: bytes of our own making alone."""
    plan: Plan = pickle.loads(parcel)
    return plan


class _Pickler(pickle.Pickler):
    def reducer_override(self, item: Any) -> Any:
        import control

        if not isinstance(item, control.StateSpace):
            return NotImplemented
        matrices = tuple(np.asarray(getattr(item, name), dtype=np.float64) for name in "ABCD")
        names = (list(item.input_labels), list(item.output_labels), list(item.state_labels), item.name)
        return _state_space, (matrices, item.dt, *names)


def _state_space(
    matrices: tuple[Any, ...], dt: float, inputs: list[str], outputs: list[str], states: list[str], name: str
) -> control.StateSpace:
    import control

    # A state that no input or output sees belongs to the controller all the same.
    return control.StateSpace(
        *matrices, dt, inputs=inputs, outputs=outputs, states=states, name=name, remove_useless_states=False
    )
