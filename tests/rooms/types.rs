//! The names of types that code outside of their file's module can use.

use super::source::{Source, after_group};
use std::collections::BTreeMap;

/// Words that begin the definition of a type.
const TYPE_WORDS: [&str; 5] = ["struct", "enum", "union", "trait", "type"];

/// The types of a file that are visible outside of their module: name and place.
fn visible_types(source: &Source) -> Vec<(String, String)> {
    let all = &source.tokens;
    let text = |i: usize| all.get(i).map_or("", |token| token.text.as_str());
    let mut found = Vec::new();
    for i in (0..all.len()).filter(|i| text(*i) == "pub") {
        let mut word = if text(i + 1) == "(" { after_group(all, i + 1) } else { i + 1 };
        if text(word) == "unsafe" {
            word += 1;
        }
        let name = text(word + 1);
        if TYPE_WORDS.contains(&text(word)) && name.starts_with(char::is_alphabetic) {
            found.push((name.to_owned(), format!("{}:{}", source.path, all[word].line)));
        }
    }
    found
}

/// Names that several visible types have, but for the `allowed` ones, each with its reason; and of these those that are not shared.
pub fn shared_names(sources: &[Source], allowed: &[(&str, &str)]) -> Vec<String> {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (name, place) in sources.iter().flat_map(visible_types) {
        places.entry(name).or_default().push(place);
    }
    places.retain(|_, places| places.len() > 1);
    let needless = allowed.iter().filter(|(name, _)| !places.contains_key(*name));
    let needless: Vec<String> = needless
        .map(|(name, reason)| format!("no two types are called `{name}` ({reason}); allow it no more"))
        .collect();
    let shared = places.iter().filter(|(name, _)| allowed.iter().all(|(other, _)| other != name));
    let shared = shared.map(|(name, places)| {
        format!("{}: type `{name}` is also in {}; rename one", places[0], places[1..].join(" and "))
    });
    shared.chain(needless).collect()
}
