"""Scene files and the MuJoCo worlds they describe."""
