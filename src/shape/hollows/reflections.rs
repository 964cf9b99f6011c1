//! Fills again what a search for hollows has opened because of reflections.
//!
//! What metal or glaze mirrors seems to lie behind the surface, as the floor of a hollow does. But the floor of a hollow is a surface with a
//! pattern, on which all photographs agree once it is laid open; on the floor of what a reflection has opened they agree no better than
//! before ([`pattern_shares`]). Each connected space that was opened is judged as a whole by the surface that borders on it.

use crate::sdf::SdfGrid;
use crate::shape::parts::extract_parts;
use crate::shape::silhouette::Silhouette;
use crate::shape::stereo::match_picture::MatchPicture;
use crate::shape::stereo::pattern::pattern_shares;
use crate::shape::stereo::votes::Shell;

/// Share of the pattern on the floor of a hollow, on average, below which it was opened by reflections.
const LEAST_PATTERN: f32 = 0.475;
/// Stands for grid vertices that were not opened, and for those whose space is not known yet.
const NONE: u32 = u32::MAX;
const UNKNOWN: u32 = u32::MAX - 1;

/// Fills the spaces of `grid` that were opened since it was `closed`, and whose floors show no pattern.
pub(super) fn fill_reflections(
    grid: &mut SdfGrid,
    closed: &SdfGrid,
    silhouettes: &[Silhouette],
    pictures: &[MatchPicture],
) {
    let mesh = extract_parts(grid, silhouettes);
    let shell = Shell::new(&mesh);
    let shares = pattern_shares(&mesh, &shell, pictures);
    let (spaces, count) = opened_spaces(grid, closed);
    let (mut sums, mut counts) = (vec![0.0; count], vec![0.0; count]);
    for (at, share) in shell.positions.iter().zip(shares) {
        let bordering =
            grid.corners(*at).map(|(row, _)| spaces[row]).into_iter().find(|space| *space < UNKNOWN);
        if let Some(space) = bordering {
            sums[space as usize] += share;
            counts[space as usize] += 1.0;
        }
    }
    let is_reflection: Vec<bool> =
        sums.iter().zip(&counts).map(|(sum, count)| *sum < LEAST_PATTERN * count).collect();
    if !is_reflection.contains(&true) {
        return;
    }
    for (row, space) in spaces.iter().enumerate() {
        if *space < UNKNOWN && is_reflection[*space as usize] {
            grid.values[row] = closed.values[row];
        }
    }
    grid.redistance();
}

/// For each vertex of the grid the number of the opened space that it is in, and how many spaces there are. Vertices hang together
/// along edges; none at the border of the grid is opened, since the object ends before it.
pub(super) fn opened_spaces(grid: &SdfGrid, closed: &SdfGrid) -> (Vec<u32>, usize) {
    let is_opened = |(now, before): (&f32, &f32)| if *now >= 0.0 && *before < 0.0 { UNKNOWN } else { NONE };
    let mut spaces: Vec<u32> = grid.values.iter().zip(&closed.values).map(is_opened).collect();
    let side = grid.side as usize;
    let mut count = 0;
    let mut open = Vec::new();
    for start in 0..spaces.len() {
        if spaces[start] == UNKNOWN {
            open.push(start);
            spaces[start] = count;
            while let Some(row) = open.pop() {
                for stride in [1, side, side * side] {
                    for next in [row.checked_sub(stride), row.checked_add(stride)].into_iter().flatten() {
                        if spaces.get(next) == Some(&UNKNOWN) {
                            spaces[next] = count;
                            open.push(next);
                        }
                    }
                }
            }
            count += 1;
        }
    }
    (spaces, count as usize)
}
