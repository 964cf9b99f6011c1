//! Which pixels are kept where a pool has no room for all: each texel gets its share.

/// The texel of a pixel that shows none.
pub(super) const NO_TEXEL: u32 = u32::MAX;

/// Marks those of the pixels with these texels that are kept, at most `most`: of each texel the first ones, up to a number that is the same for all texels,
/// and one more of the first that have more. Pixels of [`NO_TEXEL`] are not kept.
///
/// Takes time and memory by the number of pixels and the greatest texel.
pub(super) fn kept_evenly(texels: &[u32], most: usize) -> Vec<bool> {
    let mut counts =
        vec![0u32; texels.iter().filter(|t| **t != NO_TEXEL).max().map_or(0, |t| *t as usize + 1)];
    texels.iter().filter(|t| **t != NO_TEXEL).for_each(|t| counts[*t as usize] += 1);
    let (share, mut spare) = even_share(&counts, most);
    let mut kept = vec![0u32; counts.len()];
    let keep = |texel: &u32| {
        let Some(kept) = kept.get_mut(*texel as usize) else { return false };
        let is_extra = *kept == share && spare > 0;
        if *kept < share || is_extra {
            *kept += 1;
            spare -= usize::from(is_extra);
            return true;
        }
        false
    };
    texels.iter().map(keep).collect()
}

/// The greatest share for which no more than `most` are kept of so many of each texel, and what is left then.
fn even_share(counts: &[u32], most: usize) -> (u32, usize) {
    let kept = |share: u32| counts.iter().map(|count| (*count).min(share) as usize).sum::<usize>();
    let (mut low, mut high) = (0, counts.iter().copied().max().unwrap_or(0));
    while low < high {
        let middle = low + (high - low).div_ceil(2);
        if kept(middle) <= most { low = middle } else { high = middle - 1 }
    }
    (low, most - kept(low))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rare_texels_keep_all_and_the_others_an_even_share() {
        // Six of texel 0, three of texel 1, one of texel 3, and one that misses.
        let texels = [0, 0, 1, NO_TEXEL, 0, 1, 0, 3, 1, 0, 0];
        let of = |kept: &[bool], texel: u32| {
            texels.iter().zip(kept).filter(|(t, kept)| **t == texel && **kept).count()
        };
        for (most, expected) in
            [(10, [6, 3, 1]), (20, [6, 3, 1]), (7, [3, 3, 1]), (6, [3, 2, 1]), (2, [1, 1, 0]), (0, [0; 3])]
        {
            let kept = kept_evenly(&texels, most);
            assert_eq!([0, 1, 3].map(|texel| of(&kept, texel)), expected, "{most}");
            assert!(!kept[3]);
        }
        // The first ones of a texel.
        assert_eq!(
            kept_evenly(&texels, 3),
            [0, 2, 7].iter().fold(vec![false; 11], |mut kept, at| {
                kept[*at] = true;
                kept
            })
        );
        assert!(kept_evenly(&[], 5).is_empty());
    }
}
