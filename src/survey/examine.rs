//! All findings about the views of a data set, taken together.

use crate::dataset::Layout;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::triangles::Mesh;
use crate::survey::agreement;
use crate::survey::cameras::{Arrangement, same_cameras};
use crate::survey::consensus::{self, Consensus};
use crate::survey::finding::{Finding, Severity};
use crate::survey::look::ViewLook;
use crate::survey::masks;
use crate::survey::meeting::check_masks;
use crate::survey::mesh_overlap::agreements;
use crate::survey::photographs::{self, NeighborComparison};
use crate::survey::texture_detail;
use crate::survey::turntable::{self, Background};
use crate::view::Split;
use glam::Vec3;
use std::collections::BTreeSet;

/// What the views are of, as far as it is known, and what they are for.
pub struct Subject<'a> {
    /// The object, in the coordinates of the cameras; `None` if its shape is to be found from the masks.
    pub mesh: Option<&'a Mesh>,
    /// The data's up direction.
    pub up: Vec3,
    /// Width and height of the texture in texels.
    pub texture_size: u32,
    /// Whether a fit makes the texture as fine as the photographs.
    pub refined: bool,
    /// Whether test views are scored against their photographs.
    pub scored: bool,
}

/// The views of a data set, and what was found about them. Lists have one entry per view.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    /// The layout that was found.
    pub layout: Layout,
    /// What reading the data has to say.
    pub notes: Vec<String>,
    /// The views: training views, then test views, each in natural order of their names; a name that both splits have is written
    /// `train/NAME` or `test/NAME`.
    pub looks: Vec<ViewLook>,
    /// Each view beside those from nearly the same side.
    pub compared: Vec<NeighborComparison>,
    /// Intersection over union of each view's mask with the known mesh.
    pub mesh_iou: Vec<Option<f32>>,
    /// Without a mesh: how well the masks agree with their visual hull (mean intersection over union).
    pub hull_iou: Option<f32>,
    /// Without a mesh: the share of each view's mask that the visual hull of the others leaves uncovered.
    pub mask_uncovered: Vec<Option<f32>>,
    /// How the cameras lie; `None` if they look along one line.
    pub arrangement: Option<Arrangement>,
    /// How much the backgrounds are alike (correlation), if they are not plain.
    pub background: Option<f32>,
    /// What is wrong, errors first.
    pub findings: Vec<Finding>,
}

impl Survey {
    /// Whether the cameras lie on rings and the background says that the object turned before them.
    pub fn is_turntable(&self) -> bool {
        turntable::is_turntable(self.arrangement.as_ref(), self.background)
    }

    /// Findings of one severity.
    pub fn findings_of(&self, severity: Severity) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(move |finding| finding.severity == severity)
    }

    /// Names of the findings that name a view.
    pub fn flags(&self, view: &str) -> Vec<&'static str> {
        let about = |finding: &&Finding| finding.views.iter().any(|name| name == view);
        self.findings.iter().filter(about).map(|finding| finding.name).collect()
    }
}

/// Finds what is wrong with views of `subject`; `backgrounds` are those of some photographs, before masks make them black.
pub fn examine(mut looks: Vec<ViewLook>, subject: &Subject, backgrounds: &[Background]) -> Survey {
    tell_apart(&mut looks);
    let mut survey = Survey { looks, ..Survey::default() };
    survey.findings = photographs::of_radiance(&survey.looks);
    survey.findings.extend(photographs::of_duplicates(&survey.looks));
    survey.findings.extend(masks::of_masks(&survey.looks, subject.scored, subject.mesh.is_some()));
    survey.findings.extend(same_cameras(&survey.looks));
    match subject.mesh.filter(|mesh| !mesh.triangles.is_empty()) {
        // Views that all have one camera agree with nothing.
        _ if survey.findings_of(Severity::Error).any(|error| error.name == "same-cameras") => {}
        Some(mesh) => beside_mesh(&mut survey, mesh, subject.up),
        None => beside_hull(&mut survey, subject.up),
    }
    // An error about no view in particular is one of the poses, which then say nothing about neighbors.
    let poses_are_right = !survey.findings_of(Severity::Error).any(|error| error.views.is_empty());
    if let Some(arrangement) = survey.arrangement.as_ref().filter(|_| poses_are_right) {
        let directions = arrangement.directions(&survey.looks);
        let spoils = |finding: &&Finding| finding.severity == Severity::Error || finding.name == "stray-view";
        let faults: Vec<&Finding> = survey.findings.iter().filter(spoils).collect();
        let is_spoiled = |look: &ViewLook| faults.iter().any(|fault| fault.views.contains(&look.name));
        let spoiled: Vec<bool> = survey.looks.iter().map(is_spoiled).collect();
        let (compared, findings) = photographs::compare(&survey.looks, &directions, &spoiled);
        survey.compared = compared;
        survey.findings.extend(findings);
    }
    survey.findings.extend(texture_detail::finding(&survey.looks, subject.texture_size, subject.refined));
    survey.background = turntable::sameness(backgrounds);
    if survey.is_turntable() {
        survey.findings.extend(survey.background.map(turntable::finding));
    }
    tidy(&mut survey);
    survey
}

/// Names of views that both splits have get that of their split in front.
fn tell_apart(looks: &mut [ViewLook]) {
    let names = |split| looks.iter().filter(move |look| look.split == split).map(|look| look.name.as_str());
    let test: BTreeSet<&str> = names(Split::Test).collect();
    let both: BTreeSet<String> =
        names(Split::Train).filter(|name| test.contains(name)).map(str::to_owned).collect();
    for look in looks.iter_mut().filter(|look| both.contains(&look.name)) {
        let split = if look.split == Split::Train { "train" } else { "test" };
        look.name = format!("{split}/{}", look.name);
    }
}

fn beside_mesh(survey: &mut Survey, mesh: &Mesh, up: Vec3) {
    let bvh = TriangleBvh::new(mesh);
    let found = agreements(&bvh, &survey.looks);
    survey.findings.extend(agreement::of_mesh(&bvh, &survey.looks, &found));
    survey.mesh_iou = found.into_iter().map(|found| Some(found?.iou)).collect();
    survey.arrangement = Arrangement::new(&survey.looks, Some(bvh.bounding_sphere().0), up);
}

fn beside_hull(survey: &mut Survey, up: Vec3) {
    let train: Vec<&ViewLook> = survey.looks.iter().filter(|look| look.split == Split::Train).collect();
    let (stray, complaint) = match check_masks(&train) {
        Ok(stray) => (stray, None),
        Err(error) => (None, Some(Finding::from_error("masks", &error))),
    };
    survey.hull_iou = consensus::hull_agreement(&survey.looks);
    // With inverted masks nothing agrees, and that is not the cameras' fault.
    let inverted = survey.findings_of(Severity::Error).any(|error| error.name == "inverted-masks");
    match survey.hull_iou {
        _ if inverted => {}
        Some(given) => {
            let found = Consensus::new(&survey.looks);
            let finding = consensus::of_masks(&survey.looks, given, found.as_ref(), complaint);
            survey.findings.extend(finding);
            survey.mask_uncovered = found.map_or(Vec::new(), |found| found.uncovered);
        }
        None => survey.findings.extend(complaint),
    }
    survey.findings.extend(stray);
    survey.arrangement = Arrangement::new(&survey.looks, None, up);
}

/// One finding of each name, the first; errors before warnings; one entry per view in every list.
fn tidy(survey: &mut Survey) {
    survey.findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    // Where a mask is inverted, the background is what was looked at.
    let inverted = survey.findings.iter().find(|finding| finding.name == "inverted-masks");
    let inverted: Vec<String> = inverted.map_or(Vec::new(), |finding| finding.views.clone());
    let is_explained = |finding: &Finding| {
        let of_light = ["black", "unscorable-masks", "duplicates", "white-masks", "coarse-texture", "cut"];
        of_light.contains(&finding.name)
            && !inverted.is_empty()
            && finding.views.iter().all(|view| inverted.contains(view))
    };
    survey.findings.retain(|finding| !is_explained(finding));
    let mut seen = Vec::new();
    survey.findings.retain(|finding| {
        let is_new = !seen.contains(&finding.name);
        seen.push(finding.name);
        is_new
    });
    survey.compared.resize(survey.looks.len(), NeighborComparison::default());
    survey.mesh_iou.resize(survey.looks.len(), None);
    survey.mask_uncovered.resize(survey.looks.len(), None);
}
