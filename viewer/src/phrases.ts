// Texts into phrases and expressions, as src/scoup/query/phrases.py and expression.py read them; their words come with the page.

/** Of `scoup.query.phrase_data`: words, a pattern of names that would be read as phrases, and what can be asked, for messages. */
export type Grammar = { relations: Record<string, string[]>; sizes: Record<string, string> } & Record<"whole" | "phrases" | "usage", string> &
  Record<"sides" | "ordinals" | "unknown" | "anything" | "fillers" | "articles" | "operators" | "beginnings" | "forms", string[]>;

/** A text, or any object, and the relation and order that single out some of its things. */
export type Phrase = { text: string; relation: string; anchors: Target[]; order: string; rank: number };
export type Target = string | Phrase;
export type Node = Target | { operator: string; parts: Node[] };

/** The texts of a target, its own first. */
export const textsOf = (target: Target): string[] =>
  typeof target === "string" ? [target] : [...(target.text ? [target.text] : []), ...target.anchors.flatMap(textsOf)];
/** A phrase and those in it; none of a text alone. */
export const phrasesOf = (target: Target): Phrase[] => (typeof target === "string" ? [] : [target, ...target.anchors.flatMap(phrasesOf)]);
/** Texts and phrases, and whether each is under an even number of “not”. */
export const leavesOf = (node: Node, sign = true): [Target, boolean][] =>
  typeof node === "object" && "operator" in node ? node.parts.flatMap((part) => leavesOf(part, sign !== (node.operator === "not"))) : [[node, sign]];

/** A text as one word, which is read as it is; and back. */
const guarded = (text: string): string => text.trim().replace(/\s+|^(?=\S)/g, "\0");
const plain = (text: string): string => text.replaceAll("\0", " ").trim().replace(/\s+/g, " ");

/** A parser by recursive descent, which takes tokens from the left. */
export class Parser {
  private rest: string[] = [];
  private source = "";
  /** The words of any relation. */
  private readonly form: string;

  /** @param names - without capitals: they are taken whole */
  constructor(
    private readonly grammar: Grammar,
    private readonly names: string[],
  ) {
    this.form = grammar.forms.join("|");
  }

  /** What a text means, and the text with quotes around names that would be read as phrases. */
  parse(text: string): { root: Node; quoted: string } {
    this.source = text.trim();
    if (this.names.includes(this.source.toLowerCase())) return { root: plain(this.source), quoted: `"${this.source}"` };
    const pieces = this.source.replace(/\?$/, "").split('"');
    if (pieces.length % 2 === 0) throw this.refusal("a double quote is not closed");
    const whole = new RegExp(this.grammar.whole, "gi");
    const quoted = pieces.map((piece, at) => (at % 2 ? piece : piece.replace(whole, '"$&"'))).join('"');
    this.rest = [];
    for (const [, inside = "", bracket = "", word = ""] of quoted.matchAll(/"([^"]*)"|([()])|([^\s()"]+)/g)) {
      const [piece, operator] = [word || guarded(inside), bracket || word.toLowerCase()];
      if (this.grammar.operators.includes(operator)) this.rest.push(operator);
      else if (piece) this.rest.push(this.rest.at(-1)?.startsWith("=") ? `${this.rest.pop()} ${piece}` : `=${piece}`);
    }
    const [root] = this.joined(["or", "+", "-"]);
    if (this.rest.length) throw this.refusal("an operator or a bracket is missing");
    return { root, quoted };
  }

  private refusal(problem: string, known = this.grammar.usage): Error {
    return new Error(`${this.source}: ${problem}; ${known}`);
  }

  /** Parts between operators, and the text that a relation behind them is about. */
  private joined(operators: string[], noun = ""): [Node, string] {
    const isAnd = operators[0] === "and";
    const part = (noun: string) => (isAnd ? this.factor(noun) : this.joined(["and"], noun));
    let [node, about] = part(noun);
    let isOne = true;
    while (operators.includes(this.rest[0])) {
      const operator = this.rest.shift()!;
      const begins = new RegExp(`^=(?:${this.form}) `, "i").test(this.rest.find((token) => token !== "not") ?? "");
      const [right, next] = part(begins ? about : "");
      node = { operator: operator === "and" || operator === "-" ? "and" : "or", parts: [node, operator === "-" ? { operator: "not", parts: [right] } : right] };
      if (!isAnd || !begins || !about) [about, isOne] = [next, false];
    }
    return [node, isOne ? about : ""];
  }

  private factor(noun: string): [Node, string] {
    let token = this.rest.shift() ?? "";
    if (token === "not") return [{ operator: "not", parts: [this.factor(noun)[0]] }, ""];
    if (token === "(") {
      const inner = this.joined(["or", "+", "-"]);
      if (this.rest.shift() !== ")") throw this.refusal("an operator or a bracket is missing");
      return inner;
    }
    if (token[0] !== "=") throw this.refusal("a text is missing");
    if (noun) token = `=${noun} ${token.slice(1)}`;
    while (token.split(/ between /i).length > token.split(" and ").length && this.rest[0] === "and" && this.rest[1]?.[0] === "=") {
      token += ` and ${this.rest.splice(0, 2)[1].slice(1)}`;
    }
    const target = this.target(token.slice(1), 0);
    return [target, guarded(typeof target === "string" ? target : target.text || "thing")];
  }

  private target(text: string, depth: number): Target {
    const { fillers, anything, relations, unknown, phrases } = this.grammar;
    if (depth > 8) throw new Error(`${this.source}: more than 8 relations within each other; ask for fewer at a time`);
    const [, before = text, form = "", after = ""] = new RegExp(`^(.+?) (${this.form}|${unknown.join("|")})(?: (.*)|$)`, "i").exec(text) ?? [];
    const relation = Object.keys(relations).find((name) => relations[name].includes(form.toLowerCase())) ?? "";
    if (form && !relation) throw this.refusal(`unknown relation '${form.toLowerCase()}'`, phrases);
    const [head, order, rank] = this.ordered(before);
    if (!relation) return order ? { text: this.noun(head), relation, anchors: [], order, rank } : plain(text);
    const spans = relation === "between" ? /^(.*?)(?<!\S)and(?!\S)(.*)$/i.exec(after)?.slice(1) : [after];
    if (!spans) throw this.refusal('"between" needs two things joined by "and"', phrases);
    const anchors = spans.map((span) => {
      const target = this.target(span.trim(), depth + 1);
      return typeof target === "string" ? this.noun(span.trim()) : target;
    });
    const own = this.noun(head.replace(new RegExp(`(?:(?:^| )(?:${fillers.join("|")}))+$`, "i"), ""));
    return { text: anything.includes(own.toLowerCase()) ? "" : own, relation, anchors, order, rank };
  }

  private noun(text: string): string {
    const bare = text.replace(new RegExp(`^(?:${this.grammar.articles.join("|")})(?: |$)`, "i"), "").replace(/(?<!\0\S*)[,;.]+$/, "");
    const isUnfinished = new RegExp(`^(?:(?:${this.form})$|${this.grammar.beginnings.join("|")})`, "i").test(bare);
    if (isUnfinished || !plain(bare)) throw this.refusal("a thing is missing", this.grammar.phrases);
    return plain(bare);
  }

  /** A text without its order; the order, and the rank in it. */
  private ordered(text: string): [string, string, number] {
    const { articles, ordinals, sides, sizes, phrases } = this.grammar;
    const start = new RegExp(`^(?:(?:${articles.join("|")}) )?(?:(${ordinals.join("|")}|[1-9][0-9]?(?:st|nd|rd|th))(?: |$))?(.*)$`, "i");
    const [, said = "", rest] = start.exec(text)!;
    const rank = ordinals.indexOf(said.toLowerCase()) + 1 || Number.parseInt(said) || 0;
    const [, size, sized = ""] = new RegExp(`^(${Object.keys(sizes).join("|")})(?: |$)(.*)`, "i").exec(rest) ?? [];
    if (size) return [sized, sizes[size.toLowerCase()], rank || 1];
    const [, counted = "", side = ""] = /^(?:(.*) )?from the (\S+)$/i.exec(rest) ?? [];
    if (side && text.split(" ").length > 3) {
      if (sides.includes(side.toLowerCase())) return [counted, side.toLowerCase(), rank || 1];
      if (rank) throw this.refusal(`unknown side '${side.toLowerCase()}'`, phrases);
    }
    if (rank > 1 && rest) throw this.refusal(`'${said.toLowerCase()}' does not say from which side it is counted`, phrases);
    return [text, "", 1];
  }
}
