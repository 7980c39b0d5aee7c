"""Annealing and A*: general searches that know no robot."""
