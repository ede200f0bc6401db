// Asks for a token when the server wants one; it stays in this tab.

import { useToken } from "./api.js";
import { h, setText } from "./dom.js";

let dialog;
let refused;
let given = false;

function build(then) {
  const input = h("input", { type: "password", id: "token", autocomplete: "off", required: "" });
  refused = h("p", { class: "result", "data-kind": "bad", role: "status" });
  const form = h(
    "form",
    { method: "dialog" },
    h("h2", { id: "login-title" }, "A token is needed"),
    h("p", {}, "This service asks for a token, made by “flankwatch token create”. It is forgotten when the tab is closed."),
    h("label", { class: "field", for: "token" }, h("span", {}, "Token"), input),
    refused,
    h("div", { class: "form-buttons" }, h("button", { type: "submit", class: "primary" }, "Log in")),
  );
  form.addEventListener("submit", () => {
    useToken(input.value);
    given = true;
    input.value = "";
    then();
  });
  return h("dialog", { id: "login", class: "records", "aria-labelledby": "login-title" }, form);
}

/** Shows the dialog whenever an answer says that a token is needed, and calls `then` once one was given. */
export function bindLogin(then) {
  document.addEventListener("tokenneeded", () => {
    if (!dialog) {
      dialog = build(then);
      document.body.append(dialog);
    }
    if (dialog.open) return;
    setText(refused, given ? "The service does not know this token." : "");
    dialog.showModal();
  });
}
