// The tokens of the service: created, shown once, and revoked.

import * as api from "./api.js";
import { h, setChildren, setText, tableHead } from "./dom.js";
import { clock } from "./format.js";
import { KeyedRows } from "./keyed-rows.js";

const SCOPES = {
  read: "view everything",
  write: "also upload records, start replays, handle alarms and add maintenance",
  admin: "also create, edit and delete assets, delete records, and create and revoke tokens",
};

/** The page of tokens. */
export class TokensPage {
  #shown;
  #session;
  #isCreating = false;
  #name = h("input", {
    id: "token-name",
    maxlength: 200,
    autocomplete: "off",
    placeholder: "e.g. press line 3",
  });
  #scopes = Object.entries(SCOPES).map(([scope, words], n) => ({
    scope,
    radio: h("input", { type: "radio", name: "token-scope", value: scope, checked: n === 0 }),
    words,
  }));
  #result = h("p", { class: "result", role: "status" });
  #first = h(
    "p",
    { class: "result", "data-kind": "part", hidden: true },
    "No tokens yet: access is open. Once the first token exists, every request needs one. The first token has the scope admin, and this browser is logged in with it.",
  );
  #made = h("div", { class: "token-made", hidden: true });
  #madeId; // of the token shown there
  #body = h("tbody");
  #rows = new KeyedRows(
    this.#body,
    ({ id }) => id,
    (token) => this.#row(token),
  );
  #table = h(
    "table",
    { hidden: true },
    tableHead(["Name", "Scope", "Created", "Identifier", h("td")]),
    this.#body,
  );
  #notice = h("p", { class: "notice" }, "Loading tokens…");
  #form;

  constructor(root) {
    const scopes = this.#scopes.map(({ scope, radio, words }) =>
      h("label", {}, radio, h("strong", {}, scope), h("span", { class: "muted" }, words)),
    );
    this.#form = h(
      "form",
      { class: "card token-form", onsubmit: (event) => this.#create(event) },
      h("h2", {}, "Create token"),
      this.#first,
      h("label", { class: "field", for: "token-name" }, h("span", {}, "Name"), this.#name),
      h("fieldset", { class: "maintenance-kinds" }, h("legend", {}, "Scope"), scopes),
      h("div", { class: "form-buttons" }, h("button", { type: "submit", class: "primary" }, "Create token")),
      this.#result,
      this.#made,
    );
    const list = h(
      "section",
      { class: "card table-card tokens", "aria-label": "Tokens" },
      this.#table,
      this.#notice,
    );
    setChildren(root, h("h1", {}, "Tokens"), h("div", { class: "alarm-grid" }, list, this.#form));
    document.title = "Tokens · flankwatch";
  }

  update() {
    return true;
  }

  /** Fetches the tokens and shows what changed. */
  async refresh(signal) {
    const [response, session] = await Promise.all([
      api.settle(api.tokens(signal)),
      api.session().catch(() => null),
    ]);
    if (response === this.#shown && session?.id === this.#session?.id) return;
    [this.#shown, this.#session] = [response, session];
    const items = response instanceof Error ? [] : response.items;
    this.#form.hidden = response instanceof Error;
    const isFirst = !(response instanceof Error) && items.length === 0 && !session;
    this.#first.hidden = !isFirst;
    for (const { scope, radio } of this.#scopes) {
      radio.disabled = isFirst && scope !== "admin";
      if (isFirst) radio.checked = scope === "admin";
    }
    this.#table.hidden = items.length === 0;
    this.#notice.hidden = items.length > 0;
    setText(this.#notice, response instanceof Error ? response.message : "No tokens yet.");
    this.#rows.show(items, (token) => JSON.stringify([token, this.#session?.id]));
  }

  #row(token) {
    const { id, name, scope, created_at: made } = token;
    const own = id === this.#session?.id;
    const revoke = h(
      "button",
      { type: "button", "aria-label": `Revoke token ${name}`, onclick: () => this.#revoke(token, own) },
      "Revoke",
    );
    return h(
      "tr",
      { "data-token": id },
      h("th", { scope: "row" }, name, own ? h("span", { class: "muted id" }, "this session") : null),
      h("td", { "data-label": "Scope" }, scope),
      h("td", { "data-label": "Created" }, clock(made)),
      h("td", { "data-label": "Identifier" }, h("code", {}, id)),
      h("td", {}, revoke),
    );
  }

  async #create(event) {
    event.preventDefault();
    if (this.#isCreating) return; // a second click before the response
    const name = this.#name.value.trim();
    this.#name.removeAttribute("aria-invalid");
    if (!name) {
      this.#name.setAttribute("aria-invalid", "true");
      this.#name.focus();
      return this.#showStatus("bad", "Enter a name.");
    }
    const scope = /** @type {Schemas["Scope"]} */ (this.#scopes.find(({ radio }) => radio.checked).scope);
    this.#isCreating = true;
    try {
      const made = await api.createToken({ name, scope });
      this.#name.value = "";
      this.#showStatus("", "");
      this.#show(made);
      if (!this.#first.hidden) {
        await api.logIn(made.token);
        document.dispatchEvent(new CustomEvent("sessionchange"));
      }
      await this.refresh();
    } catch (error) {
      this.#showStatus("bad", `Creating failed: ${error.message}.`);
    } finally {
      this.#isCreating = false;
    }
  }

  /** Shows a new token; this is the only time that it is visible. */
  #show({ id, name, token }) {
    this.#madeId = id;
    const shown = h("input", {
      readonly: true,
      value: token,
      "aria-label": `Token ${name}`,
      onfocus: (event) => event.target.select(),
    });
    const copy = h("button", { type: "button" }, "Copy");
    copy.addEventListener("click", async () => {
      try {
        await navigator.clipboard.writeText(token);
        setText(copy, "Copied");
      } catch {
        shown.select(); // without TLS, browsers give no access to the clipboard
        setText(copy, "Selected: copy it manually");
      }
    });
    const hide = h("button", { type: "button", class: "quiet", onclick: () => this.#hide() }, "Hide");
    this.#made.hidden = false;
    setChildren(
      this.#made,
      h("p", {}, h("strong", {}, `Token “${name}”. `), "It is shown only once: copy it now."),
      shown,
      h("div", { class: "form-buttons" }, copy, hide),
    );
  }

  #hide() {
    this.#made.hidden = true;
    setChildren(this.#made);
  }

  async #revoke({ id, name }, own) {
    const words = own ? "This ends your session." : "Clients that use it lose access.";
    if (!confirm(`Revoke token “${name}”? ${words}`)) return;
    const response = await api.settle(api.revokeToken(id));
    if (id === this.#madeId && !(response instanceof Error)) this.#hide();
    this.#showStatus(
      response instanceof Error ? "bad" : "good",
      response instanceof Error ? `Revoking failed: ${response.message}.` : `Token “${name}” revoked.`,
    );
    await this.refresh().catch(() => {});
  }

  #showStatus(kind, words) {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }

  /** Clears the displayed token. */
  dispose() {
    this.#hide();
  }
}
