// The words of an exported page: what the scene answers to them, and to phrases and expressions over them.
import type { Answer } from "./answers";
import { leavesOf, Parser, phrasesOf, textsOf, type Grammar, type Node } from "./phrases";
import { isSeen, Relations, type Rules } from "./relations";
import type { Packed } from "./safetensors";
import { NO_OWNER, type Thing } from "./scene_data";

/** Of `scoup.view.vocabulary.words_data`: remarks are certainty and score of each word. Fields without things have no grammar. */
export type WordsMetadata = Record<"names" | "certainties" | "remarks", string[]> & { grammar?: Grammar; rules: Rules; seen_from: string };

export class Vocabulary {
  private readonly metadata: WordsMetadata;
  private readonly folded: string[];
  private readonly parser: Parser | null;
  private readonly relations: Relations | null;
  /** Where the things of each word and level start. */
  private readonly starts = [0];

  constructor(
    private readonly words: Packed,
    things: Thing[],
  ) {
    this.metadata = words.metadata as WordsMetadata;
    const { names, grammar, rules } = this.metadata;
    this.folded = names.map((name) => name.toLowerCase());
    this.parser = grammar ? new Parser(grammar, this.folded) : null;
    this.relations = grammar ? new Relations(words.tensors, rules, new Map(things.map(({ number, name }) => [number, name ?? ""]))) : null;
    for (const count of words.tensors.get("thing_counts")?.data ?? []) this.starts.push(this.starts[this.starts.length - 1] + count);
  }

  /** @throws Error with a sentence for the visitor */
  answer(text: string): Answer {
    const { root, quoted } = this.parser?.parse(text) ?? { root: text.trim(), quoted: text };
    if (typeof root !== "string") return this.answerOfPhrase(text, quoted, root);
    return { ...this.answerOfWord(root), text, remark: null, asked: /[\s()?]/.test(root) ? `"${root}"` : root };
  }

  private rowOf(text: string): number {
    const row = this.folded.indexOf(wordForms(text).find((form) => this.folded.includes(form)) ?? "\0");
    if (row < 0) throw new Error(unknown(text, this.metadata.names) + (this.parser ? "" : " This field has no things, so pages answer single texts only."));
    return row;
  }

  private numbers(name: string) {
    return this.words.tensors.get(name)!.data;
  }

  /** Things that answer a word: without a level of choice, level by level, and the parts of the first that fit it best. */
  private things(row: number, column: number): number[] | null {
    const counts = this.words.tensors.get("thing_counts");
    if (!counts) return null;
    const at = row * counts.shape[1] + column;
    return Array.from(this.numbers("things").subarray(this.starts[at], this.starts[at + 1]));
  }

  private answerOfWord(text: string): Answer {
    const row = this.rowOf(text);
    const [, levels, atoms] = this.words.tensors.get("scores")!.shape;
    const known = (name: string) => (Number.isNaN(this.numbers(name)[row]) ? null : this.numbers(name)[row]);
    const rival = this.words.tensors.get("runner_up")?.data[row] ?? NO_OWNER;
    return {
      text,
      level: this.numbers("levels")[row],
      score: known("score"),
      certainty: this.metadata.certainties[this.numbers("certainty")[row]] ?? null,
      present: this.numbers("present")[row] > 0,
      runner_up: rival === NO_OWNER ? null : { thing: rival, score: known("runner_up_score") },
      thresholds: Array.from(this.numbers("thresholds").subarray(row * levels, (row + 1) * levels)),
      spans: Array.from({ length: levels }, (_, level): [number, number] => {
        const at = 2 * (row * levels + level);
        return [this.numbers("spans")[at], this.numbers("spans")[at + 1]];
      }),
      gaussians: this.numbers("gaussians")[row],
      chosen_things: this.things(row, 0),
      things: Array.from({ length: levels }, (_, level) => this.things(row, 1 + level)),
      without: [],
      remark: this.metadata.remarks[row],
      scores: (this.numbers("scores") as Float32Array).slice(row * levels * atoms, (row + 1) * levels * atoms),
    };
  }

  /** As `scoup.query.ask.evaluated` and `scoup.view.scene_answers` answer it. */
  private answerOfPhrase(text: string, asked: string, root: Node): Answer {
    const leaves = leavesOf(root);
    const parts = new Map(leaves.flatMap(([leaf]) => textsOf(leaf)).map((part) => [part, this.answerOfWord(part)]));
    const needed = leaves.flatMap(([leaf, sign]) => (sign ? [textsOf(leaf)] : []));
    const wanted = [...new Set(needed.length ? needed.map(([first]) => first) : parts.keys())];
    const best = wanted.map((part) => parts.get(part)!).reduce((one, other) =>
      (Number(other.present) - Number(one.present) || (other.score ?? 0) - (one.score ?? 0)) > 0 ? other : one);
    const score = needed.length ? best.score : null;
    // A runner-up is that of one text.
    const only = parts.size === 1 && leaves.every(([leaf, sign]) => sign && typeof leaf === "string");
    const remark = only || !best.runner_up ? best.remark : best.remark!.replace(`, or thing ${best.runner_up.thing}`, "");
    const partOf = (part: string, thing: number) =>
      this.things(this.rowOf(part), 1 + best.things.length)![parts.get(part)!.chosen_things!.indexOf(thing)];
    const evaluated = (things: (answer: Answer) => number[] | null, part: typeof partOf | null) =>
      this.relations!.evaluate(root, new Map([...parts].map(([part, answer]) => [part, things(answer)!])), part);
    const judged = evaluated(({ present, chosen_things: things }) => (present ? things : []), partOf);
    const present = judged.found.size > 0;
    const chosen = present ? judged : evaluated(({ chosen_things: things }) => things, partOf);
    const seen = this.metadata.seen_from && leaves.some(([leaf]) => phrasesOf(leaf).some(isSeen)) ? `, as seen from ${this.metadata.seen_from}` : "";
    const names = [...judged.found].filter(([, said]) => wanted.length > 1 || !parts.has(said)).map(([thing, said]) => (parts.has(said) ? this.metadata.names[this.rowOf(said)] : said) || `thing ${thing}`);
    const counts = [...new Set(names)].map((name) => [names.filter((each) => each === name).length, name] as const);
    const listed = counts.slice(0, 12).map(([count, name]) => (count > 1 ? `${count} x ${name}` : name)).join(", ") + (counts.length > 12 ? ", ..." : "");
    const absent = [...parts.values()].filter((part) => !part.present && needed.flat().includes(part.text)).map((part) => `${part.text}: ${part.remark}`);
    const there = [...parts.values()].filter((part) => part.present).map((part) => `${part.text}: ${part.chosen_things!.length || 1}`);
    const without = absent.join("; ") || (there.length ? `found ${there.join(", ")}, but none that is so${seen}` : "nothing found");
    return {
      ...best,
      text,
      asked,
      present,
      score,
      certainty: score === null ? null : present ? best.certainty : "not here",
      runner_up: only ? best.runner_up : null,
      gaussians: needed.length && !present ? 0 : judged.gaussians,
      chosen_things: [...chosen.found.keys()],
      things: best.things.map((_, level) => [...evaluated(({ things }) => things[level], null).found.keys()]),
      without: chosen.without,
      remark: present ? `${listed && `${listed}; `}${score === null ? "presence not judged" : remark}${seen}` : without,
    };
  }
}

/** The forms of a text that a page may know, as in Python's `word_forms`. */
function wordForms(text: string): string[] {
  const folded = text.trim().toLowerCase();
  const bare = folded.replace(/^(the|a|an)\s+/, "");
  return [folded, bare, bare.replace(/s$/, ""), bare.replace(/es$/, ""), bare.replace(/ies$/, "y")];
}

/** What is said of a word that the page does not know, with those that share most pairs of letters with it. */
function unknown(text: string, names: string[]): string {
  const pairs = (word: string) => [...word.toLowerCase()].map((letter, at, all) => letter + (all[at + 1] ?? ""));
  const wanted = new Set(pairs(text));
  const nearness = (name: string) => pairs(name).filter((pair) => wanted.has(pair)).length / Math.min(wanted.size, name.length);
  const near = [...names].sort((one, other) => nearness(other) - nearness(one)).slice(0, 4);
  return `This page knows ${names.length} words, and “${text}” is not among them. Nearest: ${near.map((name) => `“${name}”`).join(", ")}.`;
}
