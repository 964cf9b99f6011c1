//! Stanford-ORB's layout (`blender_HDR`, `blender_LDR`): NeRF's, with masks in `train_mask` and `test_mask`.
//!
//! The photographs have no alpha. `transforms_novel.json`, cameras of the same object in other places, is not read. The same photographs as
//! `llff_colmap_HDR` and `llff_colmap_LDR` are in the layout of [COLMAP](crate::dataset::colmap).

use crate::codec::nearby::missing_file_help;
use crate::dataset::load::StemIndex;
use crate::dataset::masks::find_mask;
use crate::dataset::nerf;
use crate::dataset::plan::{MaskPlan, Plan};
use crate::error::{Error, Result};
use crate::view::Split;
use std::path::{Path, PathBuf};

/// The folder of the masks of a split.
pub(crate) fn mask_folder(dir: &Path, split: Split) -> PathBuf {
    dir.join(format!("{}_mask", nerf::split_word(dir, split)))
}

/// Plans the views of a split.
pub(super) fn plan(dir: &Path, split: Split) -> Result<Plan> {
    let mut plan = nerf::plan_with(dir, split, None)?;
    let folder = mask_folder(dir, split);
    let masks = StemIndex::of_folder(&folder)?.ok_or_else(|| {
        let problem = "this folder of the Stanford-ORB layout is missing";
        Error::input(&folder, "", problem, missing_file_help(&folder))
    })?;
    for view in plan.views.iter_mut().filter(|view| view.image.is_some()) {
        if !matches!(view.mask, MaskPlan::File(_)) {
            view.mask = MaskPlan::File(find_mask(&masks, &view.name)?);
        }
    }
    Ok(plan)
}
