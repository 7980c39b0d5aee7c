"""The method: contact motions annealed between subgoals, subgoals found by A*."""
