// Asks for a token when the server wants one, and begins a session with it; ends the session when asked to.

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
    h("h2", { id: "login-title" }, "A token is needed"),
    h(
      "p",
      {},
      "This service asks for a token, made by “flankwatch token create”. This browser keeps it until it is closed or you log out.",
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
      return setText(refused, error.status === 401 ? "The service does not know this token." : error.message);
    }
    input.value = "";
    dialog.close();
    then();
  });
  return h("dialog", { id: "login", class: "records", "aria-labelledby": "login-title" }, form);
}

/** Shows the dialog whenever an answer says that a token is needed, and calls `then` once a session has begun. */
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

/** Shows a button to log out as long as there is a session, and the link to the tokens to who may change them; the function that is given back looks again. */
export function bindLogout(button, tokens) {
  button.addEventListener("click", async () => {
    await api.logOut();
    location.reload();
  });
  return async () => {
    const token = await api.session().catch(() => null);
    button.hidden = !token;
    tokens.hidden = Boolean(token) && token.scope !== "admin";
    button.title = token ? `Logged in with the token “${token.name}”, scope ${token.scope}` : "";
  };
}
