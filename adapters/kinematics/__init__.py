"""Joint positions as rotations and back, for the methods that were made for body-model parameters (DART, WANDR).

:mod:`~prbench_adapters.kinematics.skeleton` fits rotations to joints and moves a skeleton by them,
:mod:`~prbench_adapters.kinematics.rotations` writes matrices as six numbers, and
:mod:`~prbench_adapters.kinematics.worlds` turns between Y up and the Z up of each method. All differentiable.
"""
