//! Which placement of the object each photograph shows.

use super::names::quoted;
use super::plan::ViewPlan;
use crate::error::{Error, Result};
use crate::view::Placement;
use std::ffi::OsStr;
use std::path::Path;

/// The placements that these views of the data set in folder `dir` show.
///
/// # Errors
/// [`Error::Input`] that names the first view that belongs to none of `names`, though there are some.
pub(super) fn placements_of(dir: &Path, views: &[ViewPlan], names: &[String]) -> Result<Vec<Placement>> {
    views.iter().map(|view| placement_of(dir, view, names)).collect()
}

/// The first of these of which the photograph is in a folder with that name below `dir`, or has a name that begins so.
fn placement_of(dir: &Path, view: &ViewPlan, names: &[String]) -> Result<Placement> {
    let below = view.image.as_deref().map(|image| image.strip_prefix(dir).unwrap_or(image));
    let folders = below.iter().flat_map(|image| image.ancestors().skip(1));
    let folders: Vec<&OsStr> = folders.filter_map(Path::file_name).collect();
    let suits = |of: &String| view.name.starts_with(of.as_str()) || folders.contains(&OsStr::new(of));
    match names.iter().position(suits) {
        Some(number) => Ok(Placement(number as u32)),
        None if names.is_empty() => Ok(Placement::default()),
        None => {
            let problem = format!("the view {} belongs to none of the `placements`", quoted(&view.name));
            let help = "Name the folder that it is in, or what its name begins with, in `placements`.";
            Err(Error::input(&view.camera_file, &view.place, problem, help))
        }
    }
}
