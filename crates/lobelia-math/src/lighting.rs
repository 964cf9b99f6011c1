//! The light of a call: lobes, and the part of their light that reaches each point.

use crate::columns::LobeColumns;
use crate::real::Vec3Of;

/// The part of the lobes' light that reaches points which other parts of the object may occlude.
#[derive(Clone, Copy, Debug)]
pub struct Visibility<'a> {
    /// A row of [`LobeColumns::stride`] values a point: the part of each lobe's irradiance that reaches it, 0 to 255. Empty: all does.
    pub lobes: &'a [u8],
    /// One a point.
    pub points: &'a [PointVisibility],
}

impl<'a> Visibility<'a> {
    /// Runs of `count` points, as the points' own chunks.
    fn chunk(&self, index: usize, count: usize, stride: usize) -> Self {
        let part =
            |of: usize, each: usize| (index * count * each).min(of)..((index + 1) * count * each).min(of);
        Self {
            lobes: &self.lobes[part(self.lobes.len(), stride)],
            points: &self.points[part(self.points.len(), 1)],
        }
    }

    /// Of one point: its row of lobes (`None` if all light reaches it) and the rest.
    #[inline(always)]
    pub fn point(
        visibility: Option<Self>,
        index: usize,
        stride: usize,
    ) -> (Option<&'a [u8]>, PointVisibility) {
        match visibility {
            Some(v) if v.lobes.is_empty() => (None, v.points[index]),
            Some(v) => (Some(&v.lobes[index * stride..][..stride]), v.points[index]),
            None => (None, PointVisibility::OPEN),
        }
    }
}

/// The part of a point's visibility that does not depend on the lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct PointVisibility {
    /// Per channel, specular light over what it would be if nothing were hidden; more than 1 where a bright part of the object
    /// is mirrored.
    pub specular: Vec3Of<f32>,
    /// Irradiance from other parts of the object.
    pub indirect: Vec3Of<f32>,
}

impl PointVisibility {
    /// Nothing is hidden, nothing is reflected.
    pub const OPEN: Self = Self { specular: [1.0; 3], indirect: [0.0; 3] };
}

impl Default for PointVisibility {
    fn default() -> Self {
        Self::OPEN
    }
}

/// The light of a call.
#[derive(Clone, Copy, Debug)]
pub struct Lighting<'a> {
    /// The lobes.
    pub lobes: &'a LobeColumns,
    /// The part of their light that reaches the points; all of it if `None`.
    pub visibility: Option<Visibility<'a>>,
}

impl<'a> From<&'a LobeColumns> for Lighting<'a> {
    fn from(lobes: &'a LobeColumns) -> Self {
        Self { lobes, visibility: None }
    }
}

impl<'a> Lighting<'a> {
    /// The visibility of chunk `index` of `count` points each.
    pub(crate) fn chunk(&self, index: usize, count: usize) -> Option<Visibility<'a>> {
        self.visibility.map(|all| all.chunk(index, count, self.lobes.stride()))
    }

    /// # Panics
    /// Unless there is a visibility for each of `points` points, or none at all.
    pub(crate) fn check(&self, points: usize) {
        if let Some(visibility) = &self.visibility {
            assert_eq!(visibility.points.len(), points, "one visibility a point");
            let rows = [0, points * self.lobes.stride()];
            assert!(rows.contains(&visibility.lobes.len()), "one row of lobes a point, or none");
        }
    }
}
