//! What the gear model and the wear estimate are worth: the figures of the paper that the model follows, and
//! runs with the truth known.
//!
//! | module | holds |
//! | --- | --- |
//! | [`figures`] | the model's figures beside those of the paper it follows, with checks |
//! | [`evaluation`] | what the estimate is worth on simulated runs |

pub mod evaluation;
pub mod figures;
