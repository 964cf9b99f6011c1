//! The object's shape from photographs with masks: a signed distance field, fitted through the same
//! stages as light and material.
//!
//! | module | holds |
//! | --- | --- |
//! | `silhouette` | a mask with its camera, distances from it, and the loss of masks |
//! | [`hull`] | the robust visual hull of the masks as a signed distance field, its repair, and the parts of a surface |
//! | `unseen` | spans what no photograph sees of the hull |
//! | `hollows` | removes from the hull what photographs look through |
//! | [`field`] | the field as parameters: bricks of values (entities) and the field as a whole (a resource), with its adjoints |
//! | [`systems`] | the systems, which are swapped in during the fit of a shape ([`run`]) |
//! | `outline` | moves the contours of the surface to the outlines of the masks |
//! | `pictures` | photographs as small pictures of the object alone |
//! | [`stereo`] | moves a mesh to where neighboring photographs agree |
//! | [`mirror`] | gives vertices normals that explain what the surface mirrors |
//! | `shell` | the merged vertices of a mesh as a graph |
//! | [`vertices`] | a mesh's vertices as parameters of a fit |

pub mod field;
mod hollows;
pub mod hull;
pub mod mirror;
mod outline;
mod pictures;
pub mod run;
mod shell;
pub mod silhouette;
pub mod stereo;
pub mod systems;
#[cfg(test)]
pub(crate) mod test_support;
mod unseen;
pub mod vertices;

use glam::IVec3;
use lobelia_geometry::sdf::SdfGrid;
use std::collections::VecDeque;

/// The up to six neighbors of a vertex in a grid of `size` vertices along each axis.
#[inline]
fn neighbors(row: usize, size: [usize; 3]) -> impl Iterator<Item = usize> {
    let [width, height, depth] = size;
    let plane = width * height;
    let along = [(1, row % width, width), (width, row / width % height, height), (plane, row / plane, depth)];
    along.into_iter().flat_map(move |(stride, at, count)| {
        [(at > 0).then(|| row - stride), (at + 1 < count).then(|| row + stride)].into_iter().flatten()
    })
}

fn size(grid: &SdfGrid) -> [usize; 3] {
    [grid.side as usize; 3]
}

/// The vertex and those within one cell of it along each axis, by rising index, with the number of
/// axes along which each differs.
fn cube(grid: &SdfGrid, row: usize) -> impl Iterator<Item = (usize, i32)> {
    let vertex = grid.vertex(row).as_ivec3();
    let offsets = (0..27).map(|k| IVec3::new(k % 3, k / 3 % 3, k / 9) - 1);
    let inside = offsets.filter(move |offset| {
        let at = vertex + *offset;
        at.min_element() >= 0 && at.max_element() < grid.side as i32
    });
    inside.map(move |offset| (grid.index((vertex + offset).as_uvec3()), offset.abs().element_sum()))
}

/// Whether a vertex is on the border of its grid.
fn is_border(grid: &SdfGrid, row: usize) -> bool {
    let vertex = grid.vertex(row);
    vertex.min_element() == 0 || vertex.max_element() + 1 == grid.side
}

fn volume(grid: &SdfGrid) -> usize {
    grid.values.iter().filter(|value| **value < 0.0).count()
}

/// Visits all that is `open` and reached from `starts`, from near to far; it then is no longer
/// open.
fn flood<N: Iterator<Item = usize>>(
    starts: impl IntoIterator<Item = usize>,
    open: &mut [bool],
    next: impl Fn(usize) -> N,
    mut visit: impl FnMut(usize),
) {
    let mut reached = VecDeque::new();
    let mut reach = |row: usize, reached: &mut VecDeque<usize>| {
        if std::mem::replace(&mut open[row], false) {
            reached.push_back(row);
        }
    };
    starts.into_iter().for_each(|row| reach(row, &mut reached));
    while let Some(row) = reached.pop_front() {
        visit(row);
        next(row).for_each(|row| reach(row, &mut reached));
    }
}
