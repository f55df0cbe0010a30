"""A method of prime-and-reach behind the wire protocol, as the harness sees any other method."""

from __future__ import annotations

from prbench.contract import Condition, ConditionBatch, Motions
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.methods.motions import asked_for
from prbench.harness.methods.remote.answers import RemoteWeights, motions_in
from prbench.harness.methods.remote.messages import conditions_payload
from prbench.harness.methods.remote.method import Exchange, RemoteMethod

__all__ = ["RemoteAdapter", "RemoteWeights"]


class RemoteAdapter(RemoteMethod):
    """Satisfies :class:`prbench.contract.Adapter`."""

    all_conditions = Condition

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:
        """Ask the program for the motions of a batch; messages name sequences by their opaque ids.

        Raises:
            AdapterError: see :meth:`RemoteMethod.exchange`.
            MemoryError: see :meth:`RemoteMethod.exchange`.
        """
        header = {
            "message": "generate",
            "condition": batch.condition.value,
            "rows": len(batch),
            "fps": float(batch.fps),
            "seed": seed,
        }
        asked = Exchange(
            header=header,
            payload=conditions_payload(batch),
            # Twice the size of joints and gaze in float64: room for any list type, and still a bound on what is read.
            largest=2 * len(batch) * int(batch.n_frames.max()) * (N_JOINTS + 2) * 3 * 8,
            read=lambda answer, payload, number: motions_in(answer, payload, batch, number, gaze=self.gaze),
            asked_for=asked_for(batch.opaque_id),
        )
        return self.exchange(asked)
