"""`python -m tests.safety`: the table of docs/safety.md, made again in its place."""

from __future__ import annotations

from tests.safety import page

page.PAGE.write_text(page.renewed(), encoding="utf-8")
