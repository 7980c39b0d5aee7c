"""Write the pages that are made from the code: python -m pages"""

from pathlib import Path

from pages import commands, fields

DOCS = Path(__file__).parents[1] / "docs"
MADE = {"commands.md": commands.page, "fields.md": fields.page}
"""Page → what makes it."""

if __name__ == "__main__":
    for name, make in MADE.items():
        (DOCS / name).write_text(make(), encoding="utf-8")
