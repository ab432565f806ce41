"""The Grafana dashboard asks for what is exported, and for nothing else."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from failstop.fleet import metrics
from tests.support.pages import ROOT

DASHBOARD: dict[str, Any] = json.loads((ROOT / "examples" / "grafana" / "failstop.json").read_text("utf-8"))
PROMETHEUS = {"up", "instance", "job"}
"""Labels that Prometheus adds."""
BY_NAME = {family.name: family for family in metrics.FAMILIES}
QUERIES = [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]
QUERIES += [annotation["expr"] for annotation in DASHBOARD["annotations"]["list"]]
COLUMNS = 24


@pytest.mark.parametrize("query", QUERIES)
def test_a_query_names_metrics_and_labels_that_there_are(query: str) -> None:
    selectors = re.findall(r"\b(failstop_\w+|up)\{([^}]*)\}", query)
    assert selectors
    assert len(re.findall(r"\bfailstop_\w+", query.replace('".*failstop.*"', ""))) <= len(selectors)
    for name, labels in selectors:
        known = set(BY_NAME[name].labels) if name in BY_NAME else set()
        assert name in BY_NAME or name in PROMETHEUS
        assert set(re.findall(r"(\w+)\s*[=!]", labels)) <= known | PROMETHEUS
    for words in re.findall(r"\b(?:by|on|ignoring) \(([^)]*)\)", query):
        used = {label.strip() for label in words.split(",")}
        assert used <= PROMETHEUS | {
            label for name, _ in selectors if name in BY_NAME for label in BY_NAME[name].labels
        }


def test_a_counter_is_asked_how_much_it_grew() -> None:
    for query in QUERIES:
        for name in re.findall(r"\bfailstop_\w+_total\b", query):
            assert re.search(rf"(increase|rate)\({name}\{{[^}}]*\}}\[\w+\]\)", query), query


def test_words_of_a_state_are_those_that_are_exported() -> None:
    found = re.findall(r'(port|link)_state\{[^}]*state="(\w+)"', " ".join(QUERIES))
    assert found
    assert all(word in metrics.LINKS for kind, word in found if kind == "link")


def test_panels_have_ids_of_their_own_and_do_not_overlap() -> None:
    panels = DASHBOARD["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    cells: set[tuple[int, int]] = set()
    for panel in panels:
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= COLUMNS
        own = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert not own & cells, panel["title"]
        cells |= own


def test_every_panel_asks_the_source_that_is_chosen() -> None:
    names = {variable["name"] for variable in DASHBOARD["templating"]["list"]}
    assert names == {"datasource", "robot"}
    for panel in DASHBOARD["panels"]:
        for source in (panel["datasource"], *(target["datasource"] for target in panel["targets"])):
            assert source == {"type": "prometheus", "uid": "${datasource}"}
    assert set(re.findall(r"\$\{?(\w+)", json.dumps(DASHBOARD))) - {"__all"} == names
