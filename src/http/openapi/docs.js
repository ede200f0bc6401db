// Shows the description of the API; nothing is fetched from elsewhere, and no outside validator is asked.
SwaggerUIBundle({
  url: "openapi.json",
  dom_id: "#api",
  validatorUrl: null,
  deepLinking: true,
  persistAuthorization: false,
});
