/** Server-sent events out of the text of a stream, as the HTML standard has them. */

export interface ServerEvent {
  readonly id: string;
  readonly data: string;
}

/** Reads events from text that arrives in pieces of any length. */
export class EventParser {
  private rest = "";
  private id = "";
  private data: string[] = [];

  /** Returns the events that a further piece of text completes. */
  push(text: string): ServerEvent[] {
    const lines = (this.rest + text).split(/\r\n|\n|\r(?!$)/);
    this.rest = lines.pop() ?? "";
    return lines.flatMap((line) => this.line(line));
  }

  private line(line: string): ServerEvent[] {
    if (line === "") return this.complete();
    const [, field = "", value = ""] = /^([^:]*)(?:: ?(.*))?$/.exec(line) ?? [];
    if (field === "data") this.data.push(value);
    if (field === "id") this.id = value;
    return [];
  }

  private complete(): ServerEvent[] {
    const event = { id: this.id, data: this.data.join("\n") };
    const isEvent = this.data.length > 0;
    this.data = [];
    return isEvent ? [event] : [];
  }
}
