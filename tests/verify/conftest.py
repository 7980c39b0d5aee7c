"""The handmade plans, each composed once."""

import pytest
from handmade_plans import MAKERS

from regrasp.plan import Plan
from regrasp.scene.world import World


class Handmade(dict[str, tuple[Plan, World]]):
    """Name → plan and world."""

    def __repr__(self) -> str:  # hypothesis prints its arguments
        return f"Handmade({', '.join(self)})"


@pytest.fixture(scope="session")
def handmade(tmp_path_factory: pytest.TempPathFactory) -> Handmade:
    directory = tmp_path_factory.mktemp("models")
    return Handmade({name: maker(directory) for name, maker in MAKERS.items()})
