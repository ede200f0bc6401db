//! The texts that the sender of a report adds, and its sections.

use std::fmt::Write;

use super::wording::escape;

/// Texts by the sender.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Cover {
    /// The addressee.
    pub prepared_for: String,
    /// The author; if given, the report has a line for the signature.
    pub prepared_by: String,
    /// The recommendation; empty lines separate paragraphs.
    pub recommendation: String,
}

/// The sections of a report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Contents {
    /// Wear over time.
    pub wear: bool,
    /// The indicators shown over time, of [`INDICATORS`](super::INDICATORS).
    pub indicators: Vec<&'static str>,
    /// The spectrum of the last record.
    pub spectrum: bool,
    /// Alarms and maintenance.
    pub events: bool,
    /// The table of records.
    pub records: bool,
}

impl Default for Contents {
    fn default() -> Self {
        let indicators = super::INDICATORS.iter().map(|(name, ..)| *name).collect();
        Self { wear: true, indicators, spectrum: true, events: true, records: true }
    }
}

impl Cover {
    /// Writes the addressee, below the title.
    pub(super) fn addressee(&self, body: &mut String) {
        if !self.prepared_for.is_empty() {
            let _ = write!(body, "<p>Prepared for {}.</p>", escape(&self.prepared_for));
        }
    }

    /// Writes the recommendation, below the facts.
    pub(super) fn recommendation(&self, body: &mut String) {
        let paragraphs = self.recommendation.split("\n\n").map(str::trim).filter(|text| !text.is_empty());
        let paragraphs: String = paragraphs.map(|text| format!("<p>{}</p>", escape(text))).collect();
        if !paragraphs.is_empty() {
            let _ = write!(
                body,
                "<section class=\"recommendation\"><h2>Recommendation</h2>{paragraphs}</section>"
            );
        }
    }

    /// Writes the lines for place, date and signature, at the end.
    pub(super) fn signature(&self, body: &mut String) {
        if !self.prepared_by.is_empty() {
            let _ = write!(
                body,
                "<section class=\"signature\"><p><span></span>Place, date</p><p><span></span>{}</p></section>",
                escape(&self.prepared_by)
            );
        }
    }
}

/// A form that requests the page again, with the sender's texts and the chosen sections.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Form {
    /// The requested channel.
    pub channel: Option<String>,
}

/// Writes the form, which is shown on the page but not printed.
pub(super) fn form(form: &Form, cover: &Cover, contents: &Contents, body: &mut String) {
    let text = |name: &str, label: &str, value: &str| {
        format!("<label>{label}<input name=\"{name}\" value=\"{}\"></label>", escape(value))
    };
    let part = |name: &str, label: &str, is_shown: bool| {
        let [shown, out] = if is_shown { [" selected", ""] } else { ["", " selected"] };
        format!(
            "<label>{label}<select name=\"{name}\"><option value=\"true\"{shown}>shown</option>\
             <option value=\"false\"{out}>hidden</option></select></label>"
        )
    };
    let channel = form.channel.as_ref().map_or_else(String::new, |channel| {
        format!("<input type=\"hidden\" name=\"channel\" value=\"{}\">", escape(channel))
    });
    let _ = write!(
        body,
        "<details class=\"form\"><summary>Complete this report before you print or send it</summary><form>{channel}{}{}\
         <label class=\"wide\">Recommendation<textarea name=\"recommendation\" rows=\"4\">{}</textarea></label>{}{}{}{}{}\
         <button>Show</button></form></details>",
        text("prepared_for", "Prepared for", &cover.prepared_for),
        text("prepared_by", "Prepared by", &cover.prepared_by),
        escape(&cover.recommendation),
        part("wear", "Wear", contents.wear),
        choice(contents),
        part("spectrum", "Spectrum", contents.spectrum),
        part("events", "Alarms and maintenance", contents.events),
        part("records", "Table of records", contents.records),
    );
}

/// Check boxes for the indicators; the empty field stands for none.
fn choice(contents: &Contents) -> String {
    let boxes = super::INDICATORS.iter().map(|(name, heading, _)| {
        let checked = if contents.indicators.contains(name) { " checked" } else { "" };
        format!(
            "<label><input type=\"checkbox\" name=\"indicators\" value=\"{name}\"{checked}>{heading}</label>"
        )
    });
    format!(
        "<fieldset class=\"wide\"><legend>Indicators</legend><input type=\"hidden\" name=\"indicators\" value=\"\">{}</fieldset>",
        boxes.collect::<String>()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_texts_of_the_sender_are_escaped() {
        let cover = Cover {
            prepared_for: "Mill <3>".to_owned(),
            prepared_by: "A. Engineer".to_owned(),
            recommendation: "Change the oil.\n\nInspect the pinion & the wheel.".to_owned(),
        };
        let mut body = String::new();
        cover.addressee(&mut body);
        cover.recommendation(&mut body);
        cover.signature(&mut body);
        for words in [
            "<p>Prepared for Mill &lt;3&gt;.</p>",
            "<p>Change the oil.</p><p>Inspect the pinion &amp; the wheel.</p>",
            "<span></span>A. Engineer</p>",
        ] {
            assert!(body.contains(words), "{words}: {body}");
        }
        let mut nothing = String::new();
        let silent = Cover::default();
        silent.addressee(&mut nothing);
        silent.recommendation(&mut nothing);
        silent.signature(&mut nothing);
        assert_eq!(nothing, "");
    }
}
