// Asks an exported page without a browser: node ask_exported.mjs VIEWER PAGE, texts as JSON on the standard input.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";

const [viewer, page] = process.argv.slice(2);
const { buildSync } = createRequire(join(viewer, "package.json"))("esbuild");
const entry = { absWorkingDir: viewer, entryPoints: ["src/exported.ts"], bundle: true, format: "esm", write: false };
const [{ contents }] = buildSync(entry).outputFiles;
const [, data] = /window\.scoupData = (.*);\n/.exec(readFileSync(page, "utf8"));
globalThis.window = { scoupData: JSON.parse(data) };
const { ExportedPage } = await import(`data:text/javascript;base64,${Buffer.from(contents).toString("base64")}`);
const source = new ExportedPage();
const ask = (text) => source.ask([text]).then(
  ([{ scores, ...answer }]) => answer,
  (error) => ({ refused: error.message }),
);
console.log(JSON.stringify(await Promise.all(JSON.parse(readFileSync(0, "utf8")).map(ask))));
