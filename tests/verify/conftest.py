"""The handmade plans, each composed once."""

import pytest
from handmade_plans import MAKERS

from regrasp.plan import Plan
from regrasp.scene.world import World


@pytest.fixture(scope="session")
def handmade(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Plan, World]]:
    """Name → plan and world."""
    directory = tmp_path_factory.mktemp("models")
    return {name: maker(directory) for name, maker in MAKERS.items()}
