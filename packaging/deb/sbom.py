"""SBOM: what a release holds of others, or needs, with versions and licences, as CycloneDX 1.6 in JSON."""

from __future__ import annotations

import fnmatch
import hashlib
import json
import os
import re
import time
import uuid
from collections.abc import Iterable, Iterator
from importlib.metadata import Distribution
from typing import Any, NamedTuple

import licences

SCHEMA = "http://cyclonedx.org/schema/bom-1.6.schema.json"
OURS = "MIT"
CLASSIFIERS = {
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD-3-Clause",
    "MIT License": "MIT",
}
"""SPDX's word for what a package says of its licence in a classifier."""
LIBS = ".libs"
"""The end of the name of the folder in which a wheel brings shared libraries of others along."""
BUNDLED = re.compile(r"^Name: (.+)\nFiles: (?:.*/)?(.+\.so.*)\n(?:.+\n)*?License: (.+)$", re.MULTILINE)
"""What numpy's licence text says of each library inside its wheel: name, files, licence."""
EXPRESSION = re.compile(r"[\w.+-]+( (WITH|AND|OR) [\w.+-]+)*")
UNSAID = "not said"
Bill = dict[str, Any]


class Bundled(NamedTuple):
    """A library of others inside a wheel, as the wheel's own licence text names it."""

    name: str
    file: str
    """A pattern of its name, which a version such as .5.0.0 may follow."""
    licence: str


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
        for what, key in (("externalReferences", "url"), ("components", "bom-ref")):
            parts = {one[key]: one for part in (kept, row) for one in part.get(what, ())}
            if parts:
                kept[what] = [parts[name] for name in sorted(parts)]
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
    """A package by its own metadata, with the hash of the wheel that it came in where that is recorded (PEP 610), and
    with the libraries of others inside it."""
    name = re.sub(r"[-_.]+", "-", str(other.metadata["Name"])).lower()
    purl = f"pkg:pypi/{name}@{other.version}"
    said = {"type": "library", "bom-ref": purl, "name": name, "version": other.version, "purl": purl}
    came = json.loads(other.read_text("direct_url.json") or "{}")
    wheel = came.get("archive_info", {}).get("hashes", {}).get("sha256")
    file = {"type": "distribution", "url": came.get("url"), "hashes": [{"alg": "SHA-256", "content": wheel}]}
    inside = sorted(libraries(other, purl), key=lambda row: str(row["bom-ref"]))
    row = said | {"licenses": [licence(other)]} | ({"externalReferences": [file]} if wheel else {})
    return row | ({"components": inside} if inside else {})


def libraries(other: Distribution, purl: str) -> Iterator[Bill]:
    """The shared libraries of others that a wheel brings along, each by the name and licence that the wheel's own
    licence text gives it, else by its file's name."""
    texts = [file.read_text() for file in other.files or () if _is_licence(file.parts)]
    named = [Bundled(*words) for text in texts for words in BUNDLED.findall(text)]
    for file in other.files or ():
        if file.parts[0].endswith(LIBS) and ".so" in file.name:
            digest = {"alg": "SHA-256", "content": hashlib.sha256(file.read_binary()).hexdigest()}
            unnamed = Bundled(file.name.partition("-")[0], "", UNSAID)
            # Older texts of numpy's name another folder.
            for one in [each for each in named if fnmatch.fnmatch(file.name, f"{each.file}*")] or [unnamed]:
                spdx = EXPRESSION.fullmatch(one.licence)
                yield {
                    "type": "library",
                    "bom-ref": f"{purl}#{file}:{one.name}",
                    "name": one.name,
                    "hashes": [digest],
                    "licenses": [{"expression": one.licence} if spdx else {"license": {"name": one.licence}}],
                    "properties": [{"name": "failstop:file", "value": str(file)}],
                }


def _is_licence(parts: tuple[str, ...]) -> bool:
    return parts[0].endswith(".dist-info") and bool(licences.TEXTS.search(parts[-1]))


def licence(other: Distribution) -> Bill:
    """The package's word on its licence: an SPDX expression, a classifier, or words of its own."""
    told = other.metadata
    if "License-Expression" in told:
        return {"expression": told["License-Expression"]}
    classifiers = [line.rpartition(" :: ")[2] for line in told.get_all("Classifier") or () if "License ::" in line]
    for line in classifiers:
        if line in CLASSIFIERS:
            return {"license": {"id": CLASSIFIERS[line]}}
    words = (classifiers or (told.get_all("License") or [UNSAID])[0].strip().splitlines())[0]
    return {"license": {"name": words}}


def text(whole: Bill) -> str:
    """As the file has it."""
    return json.dumps(whole, indent=1) + "\n"
