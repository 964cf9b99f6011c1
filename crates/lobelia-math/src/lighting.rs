//! The light of a call: lobes, and their visibility at each point.

use crate::columns::LobeColumns;
use crate::real::Vec3Of;

/// Visibility of the light lobes at points that other parts of the object may occlude.
#[derive(Clone, Copy, Debug)]
pub struct LobeVisibility<'a> {
    /// One row of [`LobeColumns::stride`] values per point: the fraction of each lobe's irradiance that reaches it, 0 to 255. If empty, all light reaches all points.
    pub lobes: &'a [u8],
    /// One entry per point.
    pub points: &'a [PointVisibility],
}

impl<'a> LobeVisibility<'a> {
    /// The visibility of chunk `index` of `count` points.
    fn chunk(&self, index: usize, count: usize, stride: usize) -> Self {
        let part =
            |of: usize, each: usize| (index * count * each).min(of)..((index + 1) * count * each).min(of);
        Self {
            lobes: &self.lobes[part(self.lobes.len(), stride)],
            points: &self.points[part(self.points.len(), 1)],
        }
    }

    /// The visibility of one point: its row of lobes (`None` if all light reaches it) and the part that does not depend on the lobe.
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

/// The part of the visibility of a point that does not depend on the lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct PointVisibility {
    /// Ratio per channel of the specular light to the specular light without occlusion; above 1 where the point reflects a bright part
    /// of the object.
    pub specular: Vec3Of<f32>,
    /// Irradiance from other parts of the object.
    pub indirect: Vec3Of<f32>,
}

impl PointVisibility {
    /// No occlusion and no interreflection.
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
    /// Their visibility at the points; if `None`, all light reaches all points.
    pub visibility: Option<LobeVisibility<'a>>,
}

impl<'a> From<&'a LobeColumns> for Lighting<'a> {
    fn from(lobes: &'a LobeColumns) -> Self {
        Self { lobes, visibility: None }
    }
}

impl<'a> Lighting<'a> {
    /// The visibility of chunk `index` of `count` points each.
    pub fn chunk(&self, index: usize, count: usize) -> Option<LobeVisibility<'a>> {
        self.visibility.map(|all| all.chunk(index, count, self.lobes.stride()))
    }

    /// # Panics
    /// If there is a visibility, but not one for each of `points` points.
    pub(crate) fn check(&self, points: usize) {
        if let Some(visibility) = &self.visibility {
            assert_eq!(visibility.points.len(), points, "one visibility per point");
            let rows = [0, points * self.lobes.stride()];
            assert!(rows.contains(&visibility.lobes.len()), "one row of lobes per point, or none");
        }
    }
}
