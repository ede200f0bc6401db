//! The HTML page of all figures.

use super::panel::{COLOURS, Panel};
use crate::cli::simulation::plot;
use crate::figures::{Check, Figures, IndicatorState, Lines, MeshState, Vibration};
use crate::report::escape;

/// Limit of Δφ₂ in Fig. 13 (c), in 1e-4 rad.
const MAX_LEAD: f64 = 6.0;

/// Builds the page, which is self-contained.
pub(super) fn html(figures: &Figures) -> String {
    let holding = figures.checks.iter().filter(|check| check.holds).count();
    let settings = &figures.settings;
    let [slight, moderate, severe] = settings.wear_um;
    let sections: String = [
        wear(figures),
        relationship(figures),
        single_stiffness(figures),
        perfect_pairs(figures),
        worn_pairs(figures),
        carried_stiffness(figures),
        mesh_stiffness(figures),
        finite_elements(figures),
        transmission_error(figures),
        time_signals(figures),
        spectra(figures),
        envelopes(figures),
        indicators(figures),
    ]
    .concat();
    let summary: String = figures.checks.iter().map(summary_row).collect();
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>{title}</title>\
         <style>{STYLE}</style>{script}</head><body><h1>{title}</h1>\
         <p>Gear pair “{pair}”, model version {version}. Figure numbers are those of Z. Shen et al., Front. Mech. Eng. 17 (2022); all curves are \
         computed with this model. Wear01, Wear02 and Wear03 have a maximum wear depth of {slight}, {moderate} and {severe} µm: the paper does not \
         state its values. Vibration: {states} states in steps of {step} µm, records of {seconds} s at {rate} Hz.</p>\
         <h2>Statements</h2><p>{holding} of {count} hold.</p><table><thead><tr><th>Figure</th><th>Statement</th><th>Result</th><th>Measured</th></tr></thead>\
         <tbody>{summary}</tbody></table>{sections}</body></html>",
        title = "The model's figures",
        script = plot::script_element(),
        pair = escape(&figures.pair.name),
        version = figures.model_version,
        states = settings.states,
        step = settings.step_um,
        seconds = settings.seconds,
        rate = settings.sample_rate_hz,
        count = figures.checks.len(),
    )
}

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;max-width:1280px;margin:2rem auto;padding:0 1rem;color:#1b1f24}\
    table{border-collapse:collapse;width:100%}th,td{border-bottom:1px solid #d0d7de;padding:.25rem .5rem;text-align:left;vertical-align:top}\
    .panels{display:grid;gap:.5rem}.panels.several{grid-template-columns:repeat(auto-fill,minmax(min(100%,520px),1fr))}.panel{min-width:0}\
    figure{margin:0 0 2rem;break-inside:avoid}figcaption{color:#57606a;margin:.3rem 0 .6rem}h2{margin-top:2rem}\
    .yes{color:#116329;font-weight:600;white-space:nowrap}.no{color:#a40e26;font-weight:600;white-space:nowrap}.how{color:#57606a}";

fn summary_row(check: &Check) -> String {
    format!(
        "<tr><td><a href=\"#fig{0}\">{0}</a></td><td>{1}</td>{2}<td>{3}</td></tr>",
        check.figure,
        escape(check.statement),
        verdict(check),
        escape(&check.measured)
    )
}

fn verdict(check: &Check) -> &'static str {
    if check.holds { "<td class=\"yes\">✓ holds</td>" } else { "<td class=\"no\">✗ fails</td>" }
}

/// One figure with its checks.
fn section(figures: &Figures, number: u32, heading: &str, caption: &str, panels: Vec<Panel>) -> String {
    // Each panel is drawn while the page loads: the first one must not take the width of those after it.
    let several = if panels.len() > 1 { " several" } else { "" };
    let panels: String = panels.into_iter().map(Panel::html).collect();
    let rows: String = figures
        .checks
        .iter()
        .filter(|check| check.figure == number)
        .map(|check| {
            format!(
                "<tr><td>{}<br><span class=\"how\">Criterion: {}.</span></td>{}<td>{}</td></tr>",
                escape(check.statement),
                escape(check.criterion),
                verdict(check),
                escape(&check.measured)
            )
        })
        .collect();
    let table = if rows.is_empty() { String::new() } else { format!("<table><tbody>{rows}</tbody></table>") };
    format!(
        "<figure id=\"fig{number}\"><h2>Fig. {number}: {}</h2><div class=\"panels{several}\">{panels}</div><figcaption>{}</figcaption>{table}</figure>",
        escape(heading),
        escape(caption)
    )
}

/// Adds a line for each state to a panel.
fn of_states(panel: Panel, figures: &Figures, curve: impl Fn(&MeshState) -> (Vec<f64>, Vec<f64>)) -> Panel {
    figures.states.iter().zip(COLOURS).fold(panel, |panel, (state, colour)| {
        let (x, y) = curve(state);
        panel.line(state.name, colour, x, y)
    })
}

fn scaled(values: &[f64], factor: f64) -> Vec<f64> {
    values.iter().map(|value| value * factor).collect()
}

fn wear(figures: &Figures) -> String {
    let depth = |i: usize, title| {
        of_states(Panel::new(title, "α (rad)", "wear depth (µm)"), figures, |state| {
            let flank = &state.tooth_pair.flanks[i];
            (flank.alpha_rad.clone(), flank.depth_um.clone())
        })
    };
    let slope = |i: usize, title| {
        of_states(Panel::new(title, "α (rad)", "slope dh/dx"), figures, |state| {
            let flank = &state.tooth_pair.flanks[i];
            (flank.alpha_rad.clone(), flank.depth_slope.clone())
        })
    };
    let panels = vec![
        depth(0, "(a) driving gear, depth"),
        depth(1, "(b) driven gear, depth"),
        slope(0, "(c) driving gear, slope"),
        slope(1, "(d) driven gear, slope"),
    ];
    let caption = "Wear depth along the tooth's thickness and its slope, from root (left) to tip (right).";
    section(figures, 7, "wear of the flanks", caption, panels)
}

fn relationship(figures: &Figures) -> String {
    let points =
        of_states(Panel::new("(a) points of contact", "α₁ (rad)", "α₁′ (rad)"), figures, |state| {
            (state.tooth_pair.alpha1_rad.clone(), state.tooth_pair.alpha1_prime_rad.clone())
        });
    let rotations = of_states(Panel::new("(b) rotations", "φ₁ (rad)", "φ₂ (rad)"), figures, |state| {
        (state.tooth_pair.phi1_rad.clone(), state.tooth_pair.phi2_rad.clone())
    });
    let caption =
        "Contact points of the flanks of one tooth pair, and the gear rotations at which they touch.";
    section(figures, 8, "mesh relationship of one pair of teeth", caption, vec![points, rotations])
}

fn single_stiffness(figures: &Figures) -> String {
    let panel = of_states(Panel::new("", "φ₁ (rad)", "stiffness (10⁸ N/m)"), figures, |state| {
        let pair = &state.tooth_pair;
        (pair.phi1_rad.clone(), scaled(&pair.stiffness_n_per_m, 1e-8))
    });
    let caption = "Stiffness of one tooth pair over its whole range of possible contact.";
    section(figures, 11, "single-tooth stiffness", caption, vec![panel])
}

/// Draws three consecutive tooth pairs.
fn three_pairs(title: &str, figures: &Figures, state: &MeshState) -> Panel {
    let pitch = |i: usize| std::f64::consts::TAU / f64::from(figures.pair.geometry.teeth[i]);
    let pair = &state.tooth_pair;
    let shifted = |values: &[f64], by: f64| values.iter().map(|value| value + by).collect::<Vec<_>>();
    (0..3).fold(Panel::new(title, "φ₁ (rad)", "φ₂ (rad)"), |panel, n| {
        let by = f64::from(n);
        panel.line(
            ["first pair", "second pair", "third pair"][n as usize],
            [COLOURS[1], COLOURS[2], COLOURS[3]][n as usize],
            shifted(&pair.phi1_rad, by * pitch(0)),
            shifted(&pair.phi2_rad, by * pitch(1)),
        )
    })
}

fn perfect_pairs(figures: &Figures) -> String {
    let state = &figures.states[0];
    let single = Panel::new("(a) one pair", "φ₁ (rad)", "φ₂ (rad)").line(
        "",
        COLOURS[0],
        state.tooth_pair.phi1_rad.clone(),
        state.tooth_pair.phi2_rad.clone(),
    );
    let caption = "Perfect flanks: each pair follows the previous one after one pitch; where two pairs touch, their curves coincide.";
    let panels = vec![single, three_pairs("(b) three pairs", figures, state)];
    section(figures, 12, "rotations with perfect flanks", caption, panels)
}

fn worn_pairs(figures: &Figures) -> String {
    let state = &figures.states[1];
    let mesh = &state.mesh;
    let touching: Vec<usize> =
        (0..mesh.pair_phi1_rad.len()).filter(|i| mesh.neighbour_lead_rad[*i] > -0.9).collect();
    // Neighbours touch in two separate ranges: a NaN leaves a gap between them.
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for (k, i) in touching.iter().enumerate() {
        if k > 0 && touching[k - 1] + 1 < *i {
            x.push(f64::NAN);
            y.push(f64::NAN);
        }
        x.push(mesh.pair_phi1_rad[*i]);
        y.push(1e4 * mesh.neighbour_lead_rad[*i]);
    }
    let ends = [mesh.pair_phi1_rad[0], mesh.pair_phi1_rad[mesh.pair_phi1_rad.len() - 1]];
    let threshold = 1e4 * figures.pair.dynamics.contact_threshold_rad;
    let name = "Δφ₂ (10⁻⁴ rad)";
    let lead =
        |title: &str| {
            Panel::new(title, "φ₁ (rad)", name)
                .line("neighbour's lead", COLOURS[1], x.clone(), y.clone())
                .level("threshold", threshold, ends)
        };
    let carries = Panel::new("(d) where the pair carries", "φ₁ (rad)", "carries (1) or not (0)").line(
        "",
        COLOURS[1],
        mesh.pair_phi1_rad.clone(),
        mesh.carries.iter().map(|carries| f64::from(u8::from(*carries))).collect(),
    );
    let panels = vec![
        three_pairs("(a) three pairs", figures, state),
        lead("(b) lead of the neighbour over the pair"),
        lead("(c) the same near the threshold").y_range(name, -MAX_LEAD, MAX_LEAD),
        carries,
    ];
    let caption = "Wear01: of two pairs in possible contact, one turns the driven gear further. A pair carries load while no neighbour leads it by more than the threshold.";
    section(figures, 13, "rotations with worn flanks", caption, panels)
}

fn carried_stiffness(figures: &Figures) -> String {
    let panel = of_states(Panel::new("", "φ₁ (rad)", "stiffness (10⁸ N/m)"), figures, |state| {
        let mesh = &state.mesh;
        let carried = (0..mesh.carries.len()).filter(|i| mesh.carries[*i]);
        carried.map(|i| (mesh.pair_phi1_rad[i], 1e-8 * mesh.pair_stiffness_n_per_m[i])).unzip()
    });
    let caption = "Stiffness of one tooth pair where it carries load under the multi-tooth rule.";
    section(figures, 14, "single-tooth stiffness in the mesh", caption, vec![panel])
}

fn mesh_stiffness(figures: &Figures) -> String {
    let panel = of_states(Panel::new("", "φ₁ (rad)", "stiffness (10⁸ N/m)"), figures, |state| {
        twice(&state.mesh.phi1_rad, &state.mesh.stiffness_n_per_m, 1e-8)
    });
    let caption = "Stiffness of the whole mesh over two mesh periods.";
    section(figures, 15, "mesh stiffness", caption, vec![panel])
}

/// Repeats one period to two, thinned to every fourth point.
fn twice(phi1_rad: &[f64], values: &[f64], factor: f64) -> (Vec<f64>, Vec<f64>) {
    let period = (phi1_rad[1] - phi1_rad[0]) * phi1_rad.len() as f64;
    let all = (0..2 * phi1_rad.len()).step_by(4);
    all.map(|i| {
        let (turn, place) = (i / phi1_rad.len(), i % phi1_rad.len());
        (phi1_rad[place] + period * turn as f64, factor * values[place])
    })
    .unzip()
}

fn finite_elements(figures: &Figures) -> String {
    let curve = |i: usize| {
        (figures.states[i].mesh.phi1_rad.clone(), scaled(&figures.states[i].mesh.stiffness_n_per_m, 1e-8))
    };
    let ((x, y), (worn_x, worn_y)) = (curve(0), curve(1));
    let panel = Panel::new("", "φ₁ (rad)", "stiffness (10⁸ N/m)")
        .line("this model, no wear", COLOURS[0], x, y)
        .line("this model, Wear01", COLOURS[1], worn_x, worn_y)
        .points(
            "finite elements, no wear",
            COLOURS[3],
            figures.finite_elements.iter().map(|point| point.phi1_rad).collect(),
            figures.finite_elements.iter().map(|point| 1e-8 * point.stiffness_n_per_m).collect(),
        );
    let caption = if figures.finite_elements.is_empty() {
        "There is no finite-element table for this gear pair."
    } else {
        "One mesh period compared with a plane-strain finite-element model of the same pair (1300 N·m, bore radius 20 mm, perfect flanks). In the \
         finite-element model, elastic teeth touch early, which gives ramps instead of this model's jumps, and two pairs share the gear body."
    };
    section(figures, 17, "mesh stiffness compared with finite elements", caption, vec![panel])
}

fn transmission_error(figures: &Figures) -> String {
    let wear = of_states(
        Panel::new("(a) e_wear over two mesh periods", "φ₁ (rad)", "e_wear (µrad)"),
        figures,
        |state| twice(&state.mesh.phi1_rad, &state.mesh.e_wear_rad, 1e6),
    );
    let whole = of_states(
        Panel::new("(b) total error over one shaft turn", "turns of the driving shaft", "e (µm)"),
        figures,
        |state| (figures.turns.clone(), state.transmission_error_um.clone()),
    );
    let caption = "Unloaded static transmission error: the wear component, Eq. (31), and the total, Eq. (25), along the line of action without its random component.";
    section(figures, 18, "transmission error", caption, vec![wear, whole])
}

fn num_title(state: &Vibration) -> String {
    format!("NUM = {} ({} µm)", state.num, state.wear_um)
}

fn time_signals(figures: &Figures) -> String {
    let vibration = &figures.vibration;
    let most = vibration
        .states
        .iter()
        .flat_map(|state| &state.acceleration_m_per_s2)
        .fold(0.0, |most: f64, a| most.max(a.abs()));
    let signals = vibration.states.iter().map(|state| {
        let panel = Panel::new(&num_title(state), "time (ms)", "acceleration (m/s²)").y_range(
            "acceleration (m/s²)",
            -1.05 * most,
            1.05 * most,
        );
        panel.line("", COLOURS[2], scaled(&state.time_s, 1e3), state.acceleration_m_per_s2.clone())
    });
    let means = vibration.states.iter().map(|state| {
        let count = state.mean_period_m_per_s2.len();
        let places = (0..count).map(|i| (i as f64 + 0.5) / count as f64).collect();
        let title = format!("{}, mean mesh period", num_title(state));
        let panel =
            Panel::new(&title, "mesh periods from the nominal start of contact", "acceleration (m/s²)");
        let panel = panel.line("", COLOURS[2], places, state.mean_period_m_per_s2.clone());
        state.changes.iter().fold(panel, |panel, change| panel.mark(*change))
    });
    let caption = "Acceleration of the response coordinate over the first mesh periods, and the mean of all mesh periods of the record. Dotted lines: the \
                   number of loaded tooth pairs changes.";
    section(figures, 19, "time signals", caption, signals.chain(means).collect())
}

fn line_panels(figures: &Figures, lines: impl Fn(&Vibration) -> &Lines) -> Vec<Panel> {
    let states = &figures.vibration.states;
    let most = states.iter().flat_map(|state| &lines(state).amplitude).fold(0.0, |most: f64, a| most.max(*a));
    let panel = |state: &Vibration| {
        let lines = lines(state);
        Panel::new(&num_title(state), "frequency (Hz)", "")
            .y_range("peak amplitude (m/s²)", 0.0, 1.05 * most)
            .line("", COLOURS[2], lines.frequency_hz.clone(), lines.amplitude.clone())
    };
    states.iter().map(panel).collect()
}

fn spectra(figures: &Figures) -> String {
    let caption =
        "Amplitude spectra (Hann window, the strongest line of each 2 Hz) up to ten mesh harmonics.";
    section(figures, 20, "spectra", caption, line_panels(figures, |state| &state.spectrum))
}

fn envelopes(figures: &Figures) -> String {
    let caption =
        "Amplitude spectra of the full-band envelope (modulus of the analytic signal, mean removed).";
    section(figures, 21, "envelope spectra", caption, line_panels(figures, |state| &state.envelope))
}

fn indicators(figures: &Figures) -> String {
    let states = &figures.vibration.indicators;
    let panel = |title: String, y: &str, value: fn(&IndicatorState) -> f64| {
        let numbers = states.iter().map(|state| f64::from(state.num)).collect();
        Panel::new(&title, "NUM", y).points("", COLOURS[2], numbers, states.iter().map(value).collect())
    };
    let [rms, kurtosis, omx] = figures.vibration.spearman;
    let panels = vec![
        panel(format!("(a) RMS, ρ = {rms:.3}"), "RMS (m/s²)", |state| state.rms),
        panel(format!("(b) kurtosis, ρ = {kurtosis:.3}"), "kurtosis", |state| state.kurtosis),
        panel(format!("(c) OMX, ρ = {omx:.3}"), "first mesh amplitude (m/s²)", |state| state.omx),
    ];
    let caption =
        "Condition indicators of all wear states; ρ is Spearman's rank correlation with the state number.";
    section(figures, 22, "condition indicators", caption, panels)
}
