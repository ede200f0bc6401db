// Login dialog for a token, which starts a session; and logout.

import * as api from "./api.js";
import { h, setText } from "./dom.js";

let dialog;
let refused;

function build(then) {
  const input = h("input", { type: "password", id: "token", autocomplete: "off", required: "" });
  refused = h("p", { class: "result", "data-kind": "bad", role: "status" });
  const form = h(
    "form",
    {},
    h("h2", { id: "login-title" }, "Token required"),
    h(
      "p",
      {},
      "Enter a token created with “flankwatch token create”. You stay logged in until you close the browser or log out.",
    ),
    h("label", { class: "field", for: "token" }, h("span", {}, "Token"), input),
    refused,
    h("div", { class: "form-buttons" }, h("button", { type: "submit", class: "primary" }, "Log in")),
  );
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      await api.logIn(input.value);
    } catch (error) {
      return setText(refused, error.status === 401 ? "Unknown token." : error.message);
    }
    input.value = "";
    dialog.close();
    then();
  });
  return h("dialog", { id: "login", class: "records", "aria-labelledby": "login-title" }, form);
}

/** Shows the dialog whenever a response requires a token, and calls `then` once a session has started. */
export function bindLogin(then) {
  document.addEventListener("tokenneeded", () => {
    if (!dialog) {
      dialog = build(then);
      document.body.append(dialog);
    }
    if (dialog.open) return;
    setText(refused, "");
    dialog.showModal();
  });
}

/**
 * Shows the logout button during a session, and the link to the tokens for admins. Returns a function that
 * updates both.
 */
export function bindLogout(button, tokens) {
  button.addEventListener("click", async () => {
    await api.logOut();
    location.reload();
  });
  return async () => {
    const token = await api.session().catch(() => null);
    button.hidden = !token;
    tokens.hidden = Boolean(token) && token.scope !== "admin";
    button.title = token ? `Logged in with token “${token.name}”, scope ${token.scope}` : "";
  };
}
