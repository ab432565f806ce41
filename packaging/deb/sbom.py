"""SBOM: what a release holds of others, or needs, with versions and licences, as CycloneDX 1.6 in JSON."""

from __future__ import annotations

import json
import os
import re
import time
import uuid
from collections.abc import Iterable
from importlib.metadata import Distribution
from typing import Any

SCHEMA = "http://cyclonedx.org/schema/bom-1.6.schema.json"
OURS = "MIT"
CLASSIFIERS = {
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD-3-Clause",
    "MIT License": "MIT",
}
"""SPDX's word for what a package says of its licence in a classifier."""
Bill = dict[str, Any]


def packed(version: str, held: Iterable[Distribution], architecture: str) -> Bill:
    """Of a Debian package, which holds these."""
    return bill(version, f"pkg:deb/failstop@{version}?arch={architecture}", held, "holds")


def needing(version: str, needed: Iterable[Distribution], name: str = "failstop") -> Bill:
    """Of a wheel, which holds none of these, and is installed beside them; their versions are those of the release."""
    return bill(version, f"pkg:pypi/{name}@{version}", needed, "needs", name)


def bill(version: str, purl: str, others: Iterable[Distribution], how: str, name: str = "failstop") -> Bill:
    """A bill of materials. `how` the others belong to it: holds, needs. Its number follows from what it says."""
    found: dict[str, Bill] = {}
    for row in map(component, others):
        # One package, with the wheel of each Python.
        kept = found.setdefault(str(row["purl"]), row)
        files = {one["url"]: one for part in (kept, row) for one in part.get("externalReferences", ())}
        if files:
            kept["externalReferences"] = [files[url] for url in sorted(files)]
    rows = [found[purl] for purl in sorted(found)]
    licence = [{"license": {"id": OURS}}]
    ours = {"type": "application", "bom-ref": purl, "name": name, "version": version, "purl": purl}
    moment = time.gmtime(int(os.environ.get("SOURCE_DATE_EPOCH", time.time())))
    body: Bill = {
        "metadata": {
            "timestamp": time.strftime("%Y-%m-%dT%H:%M:%SZ", moment),
            "component": ours | {"licenses": licence, "properties": [{"name": "failstop:others", "value": how}]},
        },
        "components": rows,
        "dependencies": [
            {"ref": purl, "dependsOn": [row["bom-ref"] for row in rows]},
            *({"ref": row["bom-ref"]} for row in rows),
        ],
    }
    number = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(body, sort_keys=True))
    head = {"$schema": SCHEMA, "bomFormat": "CycloneDX", "specVersion": "1.6", "serialNumber": f"urn:uuid:{number}"}
    return head | {"version": 1} | body


def component(other: Distribution) -> Bill:
    """A package by its own metadata, with the hash of the wheel that it came in where that is recorded (PEP 610)."""
    name = re.sub(r"[-_.]+", "-", str(other.metadata["Name"])).lower()
    purl = f"pkg:pypi/{name}@{other.version}"
    said = {"type": "library", "bom-ref": purl, "name": name, "version": other.version, "purl": purl}
    came = json.loads(other.read_text("direct_url.json") or "{}")
    wheel = came.get("archive_info", {}).get("hashes", {}).get("sha256")
    file = {"type": "distribution", "url": came.get("url"), "hashes": [{"alg": "SHA-256", "content": wheel}]}
    return said | {"licenses": [licence(other)]} | ({"externalReferences": [file]} if wheel else {})


def licence(other: Distribution) -> Bill:
    """The package's word on its licence: an SPDX expression, a classifier, or words of its own."""
    told = other.metadata
    if "License-Expression" in told:
        return {"expression": told["License-Expression"]}
    classifiers = [line.rpartition(" :: ")[2] for line in told.get_all("Classifier") or () if "License ::" in line]
    for line in classifiers:
        if line in CLASSIFIERS:
            return {"license": {"id": CLASSIFIERS[line]}}
    words = (classifiers or (told.get_all("License") or ["not said"])[0].strip().splitlines())[0]
    return {"license": {"name": words}}


def text(whole: Bill) -> str:
    """As the file has it."""
    return json.dumps(whole, indent=1) + "\n"
