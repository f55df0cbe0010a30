"""EgoAllo's output files as bodies, shared by the datasets without motion capture (docs/specification/egoallo.md).

A dataset's ``find`` adds ``places.find_outputs`` to a recording's files; its ``read`` calls ``bodies.read_bodies``
with the head poses of the recording and gives what comes back to ``to_recording.body_stream``.
"""
