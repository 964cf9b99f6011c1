//! Numbers that are written are finite: every writer of floats asks here first.

use crate::{Error, Result};
use std::path::Path;

/// Checks that all `values` are finite before they are written to `path`; `what` names the value with a number, counted from 0.
///
/// # Errors
/// [`Error::Run`] that names the first value that is NaN or infinite.
pub fn check_finite(
    path: &Path,
    values: impl IntoIterator<Item = f32>,
    what: impl FnOnce(usize) -> String,
) -> Result<()> {
    match values.into_iter().position(|value| !value.is_finite()) {
        Some(at) => {
            let problem = format!("{}, so nothing is written", what(at));
            Err(Error::run(format!("writing {}", path.display()), problem))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bad_value_is_named() {
        let check = |values: &[f32]| {
            let what = |at| format!("weight {at} is not finite");
            check_finite(Path::new("a.npy"), values.iter().copied(), what)
        };
        check(&[0.0, -1.0, f32::MAX, f32::MIN_POSITIVE]).unwrap();
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let error = check(&[1.0, bad, bad]).unwrap_err().to_string();
            assert_eq!(error, "writing a.npy: weight 1 is not finite, so nothing is written");
        }
    }
}
