"""The page of the command line, made from what the commands say of themselves."""

import contextlib
import io
import os
from unittest.mock import patch

from regrasp.cli import main
from regrasp.commands.line import WORDS

WIDTH = 110
HEAD = """# Every command

Made from the code by `python -m pages`: what `regrasp COMMAND --help` prints. Each also takes `--json`: one JSON object
on stdout instead of text; progress and messages always go to stderr. Exit codes: 0 done; 1 it ran, but no plan was
found, the certificate was refused or the execution failed, with the reason; 2 bad input, in one line
`file: field: reason (hint)`.

"""


def page() -> str:
    """The page, in Markdown: each command with its options."""
    rows = [f"| [`{name}`](#{name}) | {words} |" for name, words in WORDS.items()]
    table = "\n".join(["| command | what it does |", "|---|---|", *rows, ""])
    sections = [f"## {name}\n\n```text\n{told(name)}\n```\n" for name in WORDS]
    return HEAD + "\n".join([table, *sections])


def told(name: str) -> str:
    """What `regrasp NAME --help` prints, as wide as the page."""
    out = io.StringIO()
    wide = patch.dict(os.environ, {"COLUMNS": str(WIDTH), "NO_COLOR": "1"})
    with wide, contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        main([name, "--help"])
    return "\n".join(line.rstrip() for line in out.getvalue().strip().splitlines())
