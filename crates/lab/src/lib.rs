//! Validation of the gear model and the wear estimate: the figures of the paper that the model follows, and
//! runs with known true wear.
//!
//! | module | contents |
//! | --- | --- |
//! | [`figures`] | the paper's figures computed from the model, with checks of the paper's statements |
//! | [`evaluation`] | accuracy of the wear estimate on simulated and recorded runs |

pub mod evaluation;
pub mod figures;
mod rank_correlation;
