//! The survey of a data set before a run: its contents, and what of it cannot work.
//!
//! Each view is read once, small, and reduced to a [`ViewLook`]: a few numbers and a small mask.
//! The rest are pure functions of looks, in seconds for a hundred views, with the same result at
//! every run.
//!
//! | module | holds |
//! | --- | --- |
//! | [`open`] | reading a scene's data |
//! | `photographs` | black or differently exposed photographs; inverted, dim or missing masks |
//! | [`cameras`] | cameras that do not see one point; how cameras lie, and whether the object turned instead |
//! | `silhouettes` | masks beside a known mesh, or their visual hull, and the mistake that explains a disagreement |
//! | [`estimate`] | memory and time of a scene's passes |
//! | [`table`] | the survey as text |

pub mod cameras;
pub mod estimate;
pub mod open;
mod photographs;
mod silhouettes;
pub mod table;
#[cfg(test)]
mod tests;

pub use lobelia_geometry::view::look::{MaskOrigin, ViewLook};

use cameras::{Arrangement, Background};
use estimate::Estimate;
use glam::Vec3;
use lobelia_geometry::error::{Error, Result};
use lobelia_geometry::{mesh::bvh::TriangleBvh, mesh::triangles::Mesh, view::Split};
use lobelia_io::{codec::file::write_bytes, dataset::Layout};
use serde::Serialize;
use serde_json::json;
use std::{collections::BTreeSet, path::Path};

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// A run works, perhaps worse than it could.
    Warning,
    /// A run fails, or its result is worthless.
    Error,
}

impl Severity {
    fn error_if(is_error: bool) -> Self {
        if is_error { Self::Error } else { Self::Warning }
    }
}

/// One thing that is wrong with the data.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Severity.
    pub severity: Severity,
    /// Short fixed name, e.g. `black`.
    pub name: &'static str,
    /// Views concerned, the worst first; empty if it concerns all.
    pub views: Vec<String>,
    /// Problem in one sentence that names a view.
    pub problem: String,
    /// Remedy.
    pub help: String,
}

impl Finding {
    fn new(
        severity: Severity,
        name: &'static str,
        views: Vec<String>,
        problem: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self { severity, name, views, problem: problem.into(), help: help.into() }
    }

    /// Problem and help of another check's error.
    fn from_error(name: &'static str, error: &Error) -> Self {
        Self::new(Severity::Error, name, Vec::new(), error.to_string(), error.help().unwrap_or_default())
    }

    /// The error that a run ends with.
    pub fn to_error(&self) -> Error {
        Error::usage(self.problem.clone(), self.help.clone())
    }
}

/// "view `a`", "views `a`, `b`", "views `a`, `b`, `c`, `d`, `e` and 7 more".
pub fn named(views: &[String]) -> String {
    /// The rest are counted.
    const NAMED: usize = 5;
    let list: Vec<String> = views.iter().take(NAMED).map(|view| format!("`{view}`")).collect();
    let noun = if views.len() == 1 { "view" } else { "views" };
    let rest = views.len().saturating_sub(NAMED);
    let rest = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    format!("{noun} {}{rest}", list.join(", "))
}

/// "1 warning", "2 warnings".
pub fn counted(count: usize, noun: &str) -> String {
    if count == 1 { format!("1 {noun}") } else { format!("{count} {noun}s") }
}

/// The views of a data set, and the findings about them.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Survey {
    /// The layout that was found.
    pub layout: Layout,
    /// Notes of reading the data.
    pub notes: Vec<String>,
    /// Problems, errors first.
    pub findings: Vec<Finding>,
    /// Arrangement of the cameras; `None` if they look along one line.
    #[serde(rename = "cameras")]
    pub arrangement: Option<Arrangement>,
    /// Whether masks are compared with a known mesh, in place of their visual hull.
    pub has_mesh: bool,
    /// How much the backgrounds are alike (correlation), if they are not plain.
    #[serde(rename = "background_correlation")]
    pub background: Option<f32>,
    /// Training views, then test views, each in natural order of their names; a name that both
    /// splits have is written `train/NAME` or `test/NAME`.
    #[serde(rename = "views")]
    pub looks: Vec<ViewLook>,
}

impl Survey {
    /// Whether the cameras lie on rings and the background says that the object turned before them.
    pub fn is_turntable(&self) -> bool {
        let is_on_rings = self.arrangement.as_ref().is_some_and(|arrangement| arrangement.rings.is_some());
        is_on_rings && self.background.is_some_and(|sameness| sameness >= cameras::SAME)
    }

    /// Findings of one severity.
    pub fn findings_of(&self, severity: Severity) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(move |finding| finding.severity == severity)
    }

    /// Writes the survey and an estimate of its scene as JSON.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written.
    pub fn write_json(&self, path: &Path, estimate: &Estimate) -> Result<()> {
        let failed = |error: serde_json::Error| Error::run("writing the survey", error.to_string());
        let mut value = serde_json::to_value(self).map_err(failed)?;
        let (bytes, seconds, Estimate { threads, parts }) = (estimate.bytes(), estimate.seconds(), estimate);
        value["estimate"] = json!({ "bytes": bytes, "seconds": seconds, "threads": threads, "parts": parts });
        write_bytes(path, format!("{value:#}").as_bytes())
    }
}

/// Finds problems of views of `mesh`, the object in the coordinates of the cameras, or of an object
/// whose shape is to be found from the masks. `up` is the data's up direction; `backgrounds` are
/// those of some photographs, before masks make them black.
pub fn examine(looks: Vec<ViewLook>, mesh: Option<&Mesh>, up: Vec3, backgrounds: &[Background]) -> Survey {
    let bvh = mesh.filter(|mesh| !mesh.triangles.is_empty()).map(TriangleBvh::new);
    let mut survey = Survey { looks, has_mesh: bvh.is_some(), ..Survey::default() };
    tell_apart(&mut survey.looks);
    survey.findings.extend(photographs::black(&survey.looks));
    survey.findings.extend(photographs::of_masks(&survey.looks, mesh.is_some()));
    let is_inverted = |finding: &&Finding| finding.name == "inverted-masks";
    let inverted = survey.findings.iter().find(is_inverted).cloned();
    // With inverted masks nothing agrees, and that is not the cameras' fault.
    if inverted.as_ref().is_none_or(|inverted| inverted.severity == Severity::Warning) {
        let error = cameras::check_meeting(&survey.looks).err().filter(|_| bvh.is_none());
        let complaint = error.map(|error| Finding::from_error("masks", &error));
        survey.findings.extend(silhouettes::of_silhouettes(bvh.as_ref(), &mut survey.looks, complaint));
    }
    let center = bvh.map(|bvh| bvh.bounding_sphere().0);
    survey.arrangement = Arrangement::new(&survey.looks, center, up);
    // An error about no view in particular is one of the poses, which then say nothing about
    // neighbors.
    let poses_are_right = !survey.findings_of(Severity::Error).any(|error| error.views.is_empty());
    if let Some(arrangement) = survey.arrangement.as_ref().filter(|_| poses_are_right) {
        let directions = arrangement.directions(&survey.looks);
        let spoils = |finding: &&Finding| finding.severity == Severity::Error || finding.name == "stray-view";
        let faults = || survey.findings.iter().filter(spoils);
        let is_spoiled = |look: &ViewLook| faults().any(|fault| fault.views.contains(&look.name));
        let spoiled: Vec<bool> = survey.looks.iter().map(is_spoiled).collect();
        let found = photographs::of_exposure(&mut survey.looks, &directions, &spoiled);
        survey.findings.extend(found);
    }
    survey.background = cameras::sameness(backgrounds);
    if survey.is_turntable() {
        survey.findings.extend(survey.background.map(cameras::turntable));
    }
    // Where a mask is inverted, the background is what was looked at.
    let inverted = inverted.map_or(Vec::new(), |finding| finding.views);
    survey.findings.retain(|finding| {
        let is_explained = finding.views.iter().all(|view| inverted.contains(view));
        !(is_explained && ["black", "stray-view"].contains(&finding.name))
    });
    survey.findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    survey
}

/// Names of views that both splits have get that of their split in front.
fn tell_apart(looks: &mut [ViewLook]) {
    let names = |split| looks.iter().filter(move |look| look.split == split).map(|look| look.name.clone());
    let test: BTreeSet<String> = names(Split::Test).collect();
    let both: BTreeSet<String> = names(Split::Train).filter(|name| test.contains(name)).collect();
    for look in looks.iter_mut().filter(|look| both.contains(&look.name)) {
        let split = if look.split == Split::Train { "train" } else { "test" };
        look.name = format!("{split}/{}", look.name);
    }
}
