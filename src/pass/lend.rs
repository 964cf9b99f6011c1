//! Photographs that a pass looks at, and that another of several processes keeps.

use crate::error::Result;
use crate::pass::page_cameras::page_cameras;
use crate::pass::render::chosen_views;
use crate::pass::session::Session;
use crate::pass::view_photographs::chosen_photographs;
use crate::ranks::Ranks;
use crate::ranks::owned::OwnedItems;
use crate::scene::{EvaluatePass, Pass, Truth};
use crate::view::{Photograph, ViewIndex};
use bevy_ecs::prelude::Entity;

/// Views whose photographs were brought here.
#[derive(Default)]
pub(super) struct LentPhotographs(Vec<Entity>);

impl LentPhotographs {
    /// Brings the photographs here that pass `index` looks at, which all processes carry out.
    ///
    /// # Errors
    /// If another process is gone.
    pub fn borrow(session: &mut Session, index: usize) -> Result<Self> {
        let Some(ranks) = session.sharing_ranks().cloned() else { return Ok(Self::default()) };
        let passes = &session.scene.passes;
        Self::borrow_for(session, &passes[index..=index], &ranks, None)
    }

    /// Brings the photographs here that some passes look at; if `only` one process looks, to that one.
    fn borrow_for(session: &mut Session, passes: &[Pass], ranks: &Ranks, only: Option<u32>) -> Result<Self> {
        let is_looking = only.is_none_or(|rank| rank as usize == ranks.rank());
        let mut views = looked_at(session, passes);
        let world = &mut session.pipeline.world;
        if let Some(only) = only {
            let is_there =
                |view: &Entity| world.get::<Photograph>(*view).and_then(Photograph::keeper) == Some(only);
            views.retain(|view| !is_there(view));
        }
        let photographs: Vec<&Photograph> =
            views.iter().filter_map(|view| world.get::<Photograph>(*view)).collect();
        let missing: Vec<bool> = photographs.iter().map(|photograph| !photograph.has_pixels()).collect();
        let mut lent: Vec<(Entity, Photograph)> = Vec::new();
        OwnedItems::new(photographs, Some(ranks), |photograph| photograph.keeper()).send_whole(
            |place| is_looking && missing[place],
            |photograph| Photograph::clone(photograph),
            |place, mut photograph| {
                lent.last().into_iter().for_each(|(_, other)| photograph.share_tables(other));
                lent.push((views[place], photograph));
            },
        )?;
        let borrowed = lent.iter().map(|(view, _)| *view).collect();
        for (view, photograph) in lent {
            world.entity_mut(view).insert(photograph);
        }
        Ok(Self(borrowed))
    }

    /// Leaves them to those that keep them.
    pub fn give_back(self, session: &mut Session) {
        for view in self.0 {
            let photograph = session.pipeline.world.get_mut::<Photograph>(view);
            photograph.into_iter().for_each(|mut photograph| *photograph = photograph.without_its_pixels());
        }
    }
}

/// Brings the photographs that pass `index` and those after it look at to the first process, if that is to carry them out alone.
///
/// # Errors
/// If another process is gone.
pub(super) fn hand_to_first(session: &mut Session, index: usize) -> Result<()> {
    let ranks = session.sharing_ranks().filter(|_| session.is_after_fits(index)).cloned();
    let passes = &session.scene.passes;
    ranks.map_or(Ok(()), |ranks| {
        LentPhotographs::borrow_for(session, &passes[index..], &ranks, Some(0)).map(drop)
    })
}

/// The views whose photographs passes look at and one process keeps, each once, in the order of their numbers.
fn looked_at(session: &mut Session, passes: &[Pass]) -> Vec<Entity> {
    let mut views = Vec::new();
    for pass in passes {
        views.extend(match pass {
            Pass::Evaluate(evaluate) => compared(session, evaluate),
            Pass::View(view) => {
                let world = &mut session.pipeline.world;
                let (views, cameras): (Vec<Entity>, Vec<_>) = page_cameras(world).into_iter().unzip();
                let chosen = chosen_photographs(world, &views, &cameras, view.photographs as usize);
                chosen.into_iter().map(|place| views[place]).collect()
            }
            _ => Vec::new(),
        });
    }
    let world = &session.pipeline.world;
    let keeper = |view: &Entity| world.get::<Photograph>(*view).and_then(Photograph::keeper);
    views.retain(|view| keeper(view).is_some());
    views.sort_by_key(|view| world.get::<ViewIndex>(*view).copied());
    views.dedup();
    views
}

/// The views that are scored against photographs.
fn compared(session: &mut Session, pass: &EvaluatePass) -> Vec<Entity> {
    let mut views = Vec::new();
    for score in pass.scores.iter().filter(|score| score.truth == Truth::Photographs) {
        let rendered = session.pass_named(Some(&score.pass)).and_then(Pass::render);
        let chosen = rendered.map(|settings| chosen_views(&mut session.pipeline.world, settings));
        views.extend(chosen.into_iter().flatten().map(|view| view.entity));
    }
    views
}
