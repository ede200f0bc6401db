// What the dashboard's modules find in the page, for the compiler that checks them. `./api` is made from the
// description of the API.

import type { components, paths } from "api";

declare global {
  /** The structures of the API by name. */
  type Schemas = components["schemas"];

  /** What the API answers with JSON to a GET of a path. */
  type Answer<P extends keyof paths> = paths[P] extends {
    get: { responses: { 200: { content: { "application/json": infer A } } } };
  }
    ? A
    : never;

  /** The JSON that the API takes with a method of a path. */
  type RequestBody<P extends keyof paths, M extends "post" | "put"> = paths[P][M] extends {
    requestBody?: { content: { "application/json": infer B } };
  }
    ? B
    : never;

  /** Plotly.js as the page loads it. */
  var Plotly: any;
}
