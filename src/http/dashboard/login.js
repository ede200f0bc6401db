// Asks for a token when the server wants one; it stays in this tab.

import { useToken } from "./api.js";
import { h } from "./dom.js";

let dialog;

function build(then) {
  const input = h("input", { type: "password", id: "token", autocomplete: "off", required: "" });
  const form = h(
    "form",
    { method: "dialog" },
    h("h2", {}, "A token is needed"),
    h("p", {}, "This service asks for a token, made by “flankwatch token create”. It is forgotten when the tab is closed."),
    h("label", { for: "token" }, "Token "),
    input,
    h("button", { type: "submit" }, "Log in"),
  );
  form.addEventListener("submit", () => {
    useToken(input.value);
    input.value = "";
    then();
  });
  return h("dialog", { id: "login" }, form);
}

/** Shows the dialog whenever an answer says that a token is needed, and calls `then` once one was given. */
export function bindLogin(then) {
  document.addEventListener("tokenneeded", () => {
    if (!dialog) {
      dialog = build(then);
      document.body.append(dialog);
    }
    if (!dialog.open) dialog.showModal();
  });
}
