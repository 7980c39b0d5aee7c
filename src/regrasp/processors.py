"""How many processors there are to work on."""

import os


def available() -> int:
    """Processors this process may run on; fewer than the machine has where it is confined to some."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
