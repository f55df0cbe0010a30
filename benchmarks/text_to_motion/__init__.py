"""Text-to-motion metrics in the embedding space of a text–motion matching network (Prime and Reach, section F).

The metrics are NumPy (:mod:`.metrics`); the networks (:mod:`.networks`, :mod:`.extractor`) need torch. Nothing is
imported here, so that listing the command stays quick.
"""
