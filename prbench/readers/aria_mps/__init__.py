"""Files of the Aria Machine Perception Services, shared by the Aria datasets (docs/specification/aria-mps.md).

A dataset's ``find`` adds ``find.find_mps_files`` to a recording's files; its ``read`` calls ``readings.read_mps`` and
gives what comes back to ``to_recording.mps_streams``.
"""
