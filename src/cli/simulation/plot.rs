//! A plot on a page that carries Plotly.js: traces and a layout in the terms of its JSON schema.

use std::sync::atomic::{AtomicU32, Ordering};

use serde_json::{Value, json};

use crate::http::plotly_js;

/// Number of plots drawn so far: each has an identifier of its own on its page.
static DRAWN: AtomicU32 = AtomicU32::new(0);

/// Returns the element with Plotly.js, which a page has once before its plots.
pub(super) fn script_element() -> String {
    // An end tag within the script's own strings must not end the element.
    format!("<script>{}</script>", plotly_js().replace("</script", "<\\/script"))
}

/// Returns a plot as HTML.
pub(super) fn html(traces: &[Value], layout: &Value) -> String {
    let id = DRAWN.fetch_add(1, Ordering::Relaxed);
    let config = json!({ "responsive": true, "displaylogo": false });
    // Neither must one in a name.
    let arguments = format!("{},{layout},{config}", json!(traces)).replace('<', "\\u003c");
    format!("<div id=\"plot-{id}\"></div><script>Plotly.newPlot(\"plot-{id}\",{arguments});</script>")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_does_not_end_the_script() {
        let drawn = html(&[json!({ "name": "</script><b>" })], &json!({}));
        assert_eq!(drawn.matches("</script").count(), 1, "{drawn}");
        assert!(drawn.contains(r#"{"name":"\u003c/script>\u003cb>"}"#), "{drawn}");
    }
}
