"""A method of prime-and-reach as prbench's own worker serves it."""

from __future__ import annotations

import math

from prbench.contract import Adapter
from prbench.harness.methods.motions import own_copy, well_formed
from prbench.harness.methods.remote.messages import Header, batch_of, motions_payload


def serve_motions(name: str, adapter: Adapter, header: Header, payload: bytes) -> tuple[Header, bytes]:
    """Answer a ``generate`` message.

    Args:
        name: Name of the method.
        adapter: The method.
        header: As received.
        payload: As received.

    Returns:
        Header, without the number of the batch, and payload of the answer.
    """
    batch = batch_of(header, payload)
    motions = adapter.generate(own_copy(batch), seed=header["seed"])
    motions = well_formed(motions, batch, method=name, sequence_ids=batch.opaque_id, farthest=math.inf)
    passes = {} if motions.cost is None else {"network_passes": motions.cost.network_passes}
    return {"message": "motions", **passes}, motions_payload(batch.opaque_id, motions)
