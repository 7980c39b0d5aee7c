"""Controllers that execute plans: joint impedance with the plan's contact forces fed forward, and object feedback."""
