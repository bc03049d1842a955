/**
 * <scoup-view src="scene.scoup.html">: an element with a page that `scoup view FIELD --export scene.scoup.html` wrote.
 *
 * Events, with their `detail`:
 *   asked     { answers: [{ text, present, certainty, score, gaussians, things }] } when texts are answered
 *   selected  { things: [{ number, name, position, box, ... }] } when other things are selected, or none
 */
class ScoupView extends HTMLElement {
  static observedAttributes = ["src"];
  #frame = document.createElement("iframe");
  #hear = (event) => {
    const { source, origin, data } = event;
    // Other windows can send messages, too, and the frame may have gone to another site.
    if (source !== this.#frame.contentWindow || origin !== originOf(this.#frame.src)) return;
    if (data?.scoup === "asked" || data?.scoup === "selected") {
      this.dispatchEvent(new CustomEvent(data.scoup, { detail: data.detail, bubbles: true }));
    }
  };

  constructor() {
    super();
    this.#frame.style.cssText = "width: 100%; height: 100%; border: 0";
    this.#frame.allow = "clipboard-write; fullscreen";
    const style = document.createElement("style");
    style.textContent = ":host { display: block; height: 600px }";
    this.attachShadow({ mode: "open" }).append(style, this.#frame);
  }

  connectedCallback() {
    window.addEventListener("message", this.#hear);
  }

  disconnectedCallback() {
    window.removeEventListener("message", this.#hear);
  }

  attributeChangedCallback() {
    this.#frame.title = this.title || "A scene in SCOUP";
    this.#frame.src = this.getAttribute("src") ?? "about:blank";
  }
}

/** As messages name it: files have none. */
function originOf(address) {
  const { origin, protocol } = new URL(address);
  return protocol === "file:" ? "null" : origin;
}

customElements.define("scoup-view", ScoupView);
