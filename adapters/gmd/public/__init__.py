"""Public checkpoints of GMD as weights of prbench: what :mod:`prbench_adapters.gmd.import_public` is made of."""
