// A page without a server: scene and vocabulary lie within it.
import type { Answer, Source } from "./answers";
import type { Words } from "./picking";
import { fromBase64, unpack, type Packed, type Progress, type Tensor } from "./safetensors";
import { NO_OWNER, type Metadata, type Thing } from "./scene_data";

interface PageData {
  scene: string;
  words: string;
  thumbnails: (string | null)[];
  things: Thing[];
  /** Of a large scene; of a page in several files, those that are loaded. */
  parts: string[];
}

interface WordsMetadata {
  names: string[];
  /** Scores in words, which the tensor of that name counts. */
  certainties: string[];
}

declare global {
  interface Window {
    scoupData?: PageData;
  }
}

export class ExportedPage implements Source {
  private readonly data: PageData;
  private packed: Promise<Packed> | null = null;
  private packedWords: Promise<Packed> | null = null;

  constructor() {
    if (!window.scoupData?.scene) throw new Error("the data of this page is missing; the files beside it belong to it");
    this.data = window.scoupData;
  }

  scene(progress: Progress): Promise<Packed> {
    progress("opening", 0, 0);
    this.packed ??= unpack(fromBase64(this.data.scene));
    return this.packed;
  }

  async part(number: number): Promise<Packed> {
    const { parts } = this.data;
    if (!parts[number]) await loaded(`part_${number}.js`);
    const text = parts[number];
    parts[number] = "";
    return unpack(fromBase64(text));
  }

  async metadata(): Promise<Metadata> {
    return (await this.scene(() => {})).metadata as Metadata;
  }

  async vocabulary(): Promise<{ names: string[]; closed: boolean }> {
    return { names: await this.names(), closed: true };
  }

  async things(): Promise<Thing[]> {
    return this.data.things;
  }

  thumbnail(camera: number): string | null {
    const picture = this.data.thumbnails[camera];
    return picture ? `data:image/jpeg;base64,${picture}` : null;
  }

  async ask(texts: string[]): Promise<Answer[]> {
    const names = await this.names();
    const folded = names.map((name) => name.toLowerCase());
    const rows = texts.map((text) => {
      const form = wordForms(text).find((form) => folded.includes(form));
      const row = form === undefined ? -1 : folded.indexOf(form);
      if (row < 0) throw new Error(unknown(text, names));
      return row;
    });
    const { tensors, metadata } = await this.unpackedWords();
    const { certainties } = metadata as WordsMetadata;
    const numbers = (name: string) => tensors.get(name)!.data;
    const known = (name: string, row: number) => (Number.isNaN(numbers(name)[row]) ? null : numbers(name)[row]);
    const [, levels, atoms] = tensors.get("scores")!.shape;
    const things = thingsOf(tensors);
    return rows.map((row) => {
      const spans = numbers("spans");
      const rival = tensors.get("runner_up")?.data[row] ?? NO_OWNER;
      return {
        text: names[row],
        level: numbers("levels")[row],
        score: known("score", row),
        certainty: certainties[numbers("certainty")[row]] ?? null,
        present: numbers("present")[row] > 0,
        runner_up: rival === NO_OWNER ? null : { thing: rival, score: known("runner_up_score", row) },
        thresholds: Array.from(numbers("thresholds").subarray(row * levels, (row + 1) * levels)),
        spans: Array.from({ length: levels }, (_, level): [number, number] => {
          const at = 2 * (row * levels + level);
          return [spans[at], spans[at + 1]];
        }),
        gaussians: numbers("gaussians")[row],
        chosen_things: things(row, 0),
        things: Array.from({ length: levels }, (_, level) => things(row, 1 + level)),
        without: [],
        remark: null,
        scores: (numbers("scores") as Float32Array).slice(row * levels * atoms, (row + 1) * levels * atoms),
      };
    });
  }

  private async names(): Promise<string[]> {
    return this.data.words ? ((await this.unpackedWords()).metadata as WordsMetadata).names : [];
  }

  /** What a click compares with. */
  async clickWords(): Promise<Words> {
    const names = await this.names();
    if (!names.length) return { names, scores: new Float32Array(), gram: new Float32Array() };
    const { tensors } = await this.unpackedWords();
    const [scores, gram] = ["scores", "gram"].map((name) => tensors.get(name)!.data as Float32Array);
    return { names, scores, gram };
  }

  private unpackedWords(): Promise<Packed> {
    this.packedWords ??= unpack(fromBase64(this.data.words));
    return this.packedWords;
  }
}

/** Run a script beside the page. */
function loaded(name: string): Promise<void> {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = name;
    script.onload = () => resolve();
    script.onerror = () => reject(new Error(`${name} is missing; the files beside this page belong to it`));
    document.head.append(script);
  });
}

/** Reads which things answer a word; the first column is for no level of choice. */
function thingsOf(tensors: Map<string, Tensor>): (row: number, column: number) => number[] | null {
  const counts = tensors.get("thing_counts");
  if (!counts) return () => null;
  const numbers = tensors.get("things")!.data;
  const starts = [0];
  for (const count of counts.data) starts.push(starts[starts.length - 1] + count);
  return (row, column) => {
    const at = row * counts.shape[1] + column;
    return Array.from(numbers.subarray(starts[at], starts[at + 1]));
  };
}

/** The forms of a text that a page may know, as in Python's `word_forms`. */
function wordForms(text: string): string[] {
  const folded = text.trim().toLowerCase();
  const bare = folded.replace(/^(the|a|an)\s+/, "");
  return [folded, bare, bare.replace(/s$/, ""), bare.replace(/es$/, ""), bare.replace(/ies$/, "y")];
}

/** What is said of a word that the page does not know, with the nearest that it knows. */
function unknown(text: string, names: string[]): string {
  const wanted = text.trim().toLowerCase();
  const near = names
    .map((name) => ({ name, distance: editDistance(wanted, name.toLowerCase()) }))
    .sort((a, b) => a.distance - b.distance)
    .slice(0, 4)
    .map(({ name }) => `“${name}”`);
  const phrases = /\s/.test(wanted) ? " Relations, “and”, “or” and “not” need the field itself, in scoup view." : "";
  return `This page knows ${names.length} words, and “${text}” is not among them. Nearest: ${near.join(", ")}.${phrases}`;
}

function editDistance(a: string, b: string): number {
  let row = Array.from({ length: b.length + 1 }, (_, j) => j);
  for (let i = 1; i <= a.length; i++) {
    const next = [i];
    for (let j = 1; j <= b.length; j++) {
      next[j] = Math.min(row[j] + 1, next[j - 1] + 1, row[j - 1] + (a[i - 1] === b[j - 1] ? 0 : 1));
    }
    row = next;
  }
  // A word that holds the other is near, however much longer it is.
  return row[b.length] - (b.includes(a) || a.includes(b) ? Math.max(a.length, b.length) : 0);
}
