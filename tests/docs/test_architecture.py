"""The architecture's page is short enough to be read at once."""

from __future__ import annotations

import re

from tests.support.pages import ROOT

MOST_WORDS = 2000
CODE = re.compile(r"```.*?```", re.DOTALL)


def test_the_architecture_is_told_in_2000_words() -> None:
    text = (ROOT / "docs" / "dev" / "architecture.md").read_text()
    assert len([word for word in CODE.sub("", text).split() if re.search(r"\w", word)]) <= MOST_WORDS
