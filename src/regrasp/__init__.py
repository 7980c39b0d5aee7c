"""Plans how robot fingers and cooperating arms re-configure an object."""

__version__ = "0.1.0"
