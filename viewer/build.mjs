// Bundles the page: one program with all packages, its style, and the licences of the packages in it.
import { build } from "esbuild";
import { copyFileSync, existsSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.env.SCOUP_PAGE ?? join(here, "..", "src", "scoup", "view", "page");
mkdirSync(out, { recursive: true });

const result = await build({
  absWorkingDir: here,
  entryPoints: ["src/main.ts"],
  bundle: true,
  format: "esm",
  target: "es2022",
  minify: true,
  legalComments: "none",
  metafile: true,
  outfile: join(out, "viewer.js"),
});
copyFileSync(join(here, "index.html"), join(out, "index.html"));
copyFileSync(join(here, "style.css"), join(out, "viewer.css"));
const inputs = Object.keys(result.metafile.inputs);
const apache = readFileSync(join(here, "..", "LICENSE"), "utf8"); // ours, too
writeFileSync(join(out, "licences.txt"), [licences(inputs), wasmLicences(inputs), apache].join(`\n${"-".repeat(80)}\n\n`));

/** The licence texts of the packages in the bundle: those its files are from, and what these depend on, which they may hold inlined. */
function licences(files) {
  const names = new Set(files.flatMap((file) => file.match(/node_modules\/((?:@[^/]+\/)?[^/]+)/)?.[1] ?? []));
  const facts = (name) => JSON.parse(readFileSync(join(here, "node_modules", name, "package.json"), "utf8"));
  for (const name of names) {
    // A set goes on with what is added meanwhile.
    for (const dependency of Object.keys(facts(name).dependencies ?? {})) names.add(dependency);
  }
  const texts = [...names].sort().map((name) => {
    const folder = join(here, "node_modules", name);
    const { version, license } = facts(name);
    const file = readdirSync(folder).find((entry) => /^licen[cs]e(\.\w+)?$/i.test(entry));
    if (!file || !existsSync(join(folder, file))) throw new Error(`${name} has no licence file`);
    return `${name} ${version} (${license})\n\n${readFileSync(join(folder, file), "utf8").trim()}\n`;
  });
  return `The page of scoup view contains these packages.\n\n${texts.join(`\n${"-".repeat(80)}\n\n`)}`;
}

/** The licence texts of what WebAssembly in the bundle is compiled from. No package has them: they are collected by hand. */
function wasmLicences(files) {
  const texts = readFileSync(join(here, "wasm_licences.txt"), "utf8");
  for (const file of files) {
    for (const [encoded] of readFileSync(join(here, file), "utf8").matchAll(/AGFzbQ[A-Za-z0-9+/=]+/g)) {
      // Rust keeps the paths of sources for its messages.
      for (const [, crate] of Buffer.from(encoded, "base64").toString("latin1").matchAll(/([a-z][\w-]*-\d+\.\d+\.\d+)\/src\//g)) {
        if (!texts.includes(crate)) throw new Error(`${file} contains ${crate}, which wasm_licences.txt does not name`);
      }
    }
  }
  return texts;
}
