"""Numba kernels on arrays: rotations, surfaces, contact kinematics, chains, distances and the force linear program."""
