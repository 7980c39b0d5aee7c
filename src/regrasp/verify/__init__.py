"""The judges: the certificate of a plan, sharing no mathematics with the planner."""
