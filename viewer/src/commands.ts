// What is on the screen, as commands for a terminal and for Python.
import type { Answer, Settings } from "./answers";
import type { State } from "./state";

/** For a POSIX shell. */
export function quoted(text: string): string {
  return /^[\w./:=@%+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}

function fileName(text: string): string {
  return text.replaceAll(/[^\p{L}\p{N}]+/gu, "_").replaceAll(/^_+|_+$/g, "") || "selection";
}

function rounded(value: number): string {
  return String(Math.round(value * 100) / 100);
}

/**
 * `scoup select`, and `scoup query` where a camera of the field is looked through. A threshold of one's own leaves the level that
 * answers, so texts of different levels take a command each.
 */
export function commandLine(settings: Settings, state: State, levels: string[], camera: string | null): string {
  const table = settings.text === null ? "" : ` --text ${quoted(settings.text)}`;
  const field = quoted(settings.field);
  const visible = state.visible();
  if (!visible.length) return settings.open;
  const rest = state.mode === "except";
  const groups = new Map<number | null, Answer[]>();
  for (const query of visible) {
    const level = state.threshold === null ? state.level : state.levelOf(query);
    groups.set(level, [...(groups.get(level) ?? []), query.answer]);
  }
  const always = isCertain(state);
  const lines: string[] = [];
  for (const [level, answers] of groups) {
    const words = answers.map(({ text, asked = text }) => quoted(asked)).join(" ");
    let options = table;
    if (state.threshold !== null) options += ` --threshold ${rounded(state.threshold)}`;
    if (level !== null) options += ` --level ${quoted(levels[level])}`;
    if (always) options += " --always";
    const out = `${rest ? "without_" : ""}${fileName(answers[0].text)}.ply`;
    const edit = rest ? " --edit remove" : "";
    lines.push(`scoup select ${field} ${words}${options}${edit} --out ${quoted(out)}`);
    if (camera !== null) lines.push(`scoup query ${field} ${words}${options} --camera ${quoted(camera)}`);
  }
  return lines.join("\n");
}

/** Whether a command is to find something always: the page judges presence without a level or threshold of choice. */
function isCertain(state: State): boolean {
  return state.absent || state.level !== null || state.threshold !== null;
}

/** A text with its options as the methods of a field take it. */
function question(text: string, options: string[]): string {
  return options.length ? `field.question(${[text, ...options].join(", ")})` : text;
}

export function python(settings: Settings, state: State, levels: string[], camera: string | null): string {
  const words = settings.text === null ? "" : `, words=${JSON.stringify(settings.text)}`;
  const lines = ["import scoup", "", `field = scoup.LanguageField.load(${JSON.stringify(settings.field)}${words})`];
  const rest = state.mode === "except";
  if (rest) lines.push("", "found = torch.zeros(len(field), dtype=torch.bool)");
  for (const query of state.visible()) {
    const options: string[] = [];
    const level = state.threshold === null ? state.level : state.levelOf(query);
    if (state.threshold !== null) options.push(`threshold=${rounded(state.threshold)}`);
    if (level !== null) options.push(`level=${JSON.stringify(levels[level])}`);
    if (isCertain(state)) options.push("always=True");
    const text = JSON.stringify(query.answer.asked ?? query.answer.text);
    lines.push("", `place = field.location(${question(text, options)})`);
    const name = JSON.stringify(`${fileName(query.answer.text)}.scoup`);
    lines.push(rest ? "found |= place.answer.mask" : `field[place.answer.mask].save(${name})`);
    if (camera !== null) {
      lines.push(`(seen,) = field.at(${JSON.stringify(camera)}).show([place.answer])`);
    }
  }
  if (rest) {
    lines.unshift("import torch");
    lines.push("", `field[~found].save(${JSON.stringify(`without_${fileName(state.visible()[0]?.answer.text ?? "")}.scoup`)})`);
  }
  return `${lines.join("\n")}\n`;
}
