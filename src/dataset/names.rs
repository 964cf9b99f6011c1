//! Names of views: output files have them.

use crate::codec::file::check_file_name;
use crate::dataset::ViewPlan;
use crate::error::{Error, Result};
use std::collections::HashMap;

/// Refuses names that files cannot have, and names that two views have. Names that differ only in case give a note: some file
/// systems take them for the same.
///
/// # Errors
/// [`Error::Input`] that names the view, the camera file and the place in it.
pub(super) fn check_names(plans: &[ViewPlan]) -> Result<Vec<String>> {
    let wrong = |plan: &ViewPlan, problem: String, help: &str| {
        Error::input(&plan.camera_file, &plan.place, problem, help)
    };
    let (mut seen, mut notes) = (HashMap::new(), Vec::new());
    for plan in plans {
        check_file_name(&plan.name).map_err(|problem| {
            let name: String = plan.name.escape_debug().take(60).collect();
            let help = "Output files have the view's name: give the image another.";
            wrong(plan, format!("the view name `{name}` {problem}"), help)
        })?;
        match seen.insert(plan.name.to_lowercase(), plan) {
            Some(other) if other.name == plan.name => {
                let problem = format!("two views are called `{}`; the other is {}", plan.name, other.place);
                let help =
                    "Output files have the view's name: remove one, or give the images different names.";
                return Err(wrong(plan, problem, help));
            }
            Some(other) => notes.push(format!(
                "the views {} and {} differ only in case: on some file systems one replaces the other",
                other.name, plan.name
            )),
            None => {}
        }
    }
    Ok(notes)
}
