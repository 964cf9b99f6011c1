//! The documentation is tested like code: the scene-file reference is what the types say, RON
//! blocks load, commands and flags exist, links lead somewhere, and lists are complete.
//!
//! A `ron` block is a whole `Scene(…)`, or a list of fields of a scene (`light: …`) and of passes
//! (`Edit(…)`), each of which is put into a small scene of its own. Files that a block names are
//! made, empty, before it is loaded.

mod reference;

use crate::common::{Data, Outcome, command, files_below};
use lobelia::scene::{LoadOptions, load};
use std::{collections::BTreeSet, path::Path};

/// Most words of the README.
const README_WORDS: usize = 1200;
/// The pages whose `rust` blocks are compiled, as doctests of `src/lib.rs`.
const RUST_PAGES: [&str; 2] = ["README.md", "docs/src/extending.md"];

/// The root of the repository.
pub fn repository() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn read(file: &str) -> String {
    std::fs::read_to_string(repository().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
}

/// The files below a folder of the repository whose names end so, with their texts.
pub fn files_with(folder: &str, end: &str) -> impl Iterator<Item = (String, String)> {
    let files = files_below(&repository().join(folder)).into_iter();
    let own = files.filter(move |file| file.ends_with(&format!(".{end}")) && !file.starts_with("book/"));
    own.map(move |file| format!("{folder}/{file}")).map(|file| (file.clone(), read(&file)))
}

/// A page, with its path from the root of the repository.
struct Page {
    path: String,
    text: String,
}

/// README, CHANGELOG, CONTRIBUTING and everything in `docs/`.
fn pages() -> Vec<Page> {
    let top = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(|file| (file.to_owned(), read(file)));
    top.into_iter().chain(files_with("docs", "md")).map(|(path, text)| Page { path, text }).collect()
}

impl Page {
    /// The fenced code blocks in a language: where they begin, and their texts.
    fn blocks(&self, language: &str) -> Vec<(String, String)> {
        let parts: Vec<&str> = self.text.split("```").collect();
        assert!(parts.len() % 2 == 1, "{}: a code block is not closed", self.path);
        let mut blocks = Vec::new();
        for at in (1..parts.len()).step_by(2) {
            let (head, text) = parts[at].split_once('\n').unwrap_or_default();
            if head.split(',').next() == Some(language) {
                let line = 1 + parts[..at].iter().map(|part| part.matches('\n').count()).sum::<usize>();
                blocks.push((format!("{}:{line}", self.path), text.to_owned()));
            }
        }
        blocks
    }

    /// The text without code, line by line.
    fn prose(&self) -> Vec<String> {
        let text: String = self.text.split("```").step_by(2).collect();
        text.lines().map(|line| line.split('`').step_by(2).collect::<Vec<_>>().join("`")).collect()
    }

    /// Returns the targets of its links and pictures.
    fn targets(&self) -> Vec<String> {
        let mut targets = Vec::new();
        for line in self.prose() {
            for (before, after) in [("](", ')'), ("src=\"", '"'), ("href=\"", '"'), ("srcset=\"", '"')] {
                let parts = line.split(before).skip(1).filter_map(|rest| rest.split(after).next());
                targets.extend(parts.map(str::to_owned));
            }
        }
        targets
    }

    /// The anchors of its headings.
    fn anchors(&self) -> Vec<String> {
        let text: String = self.text.split("```").step_by(2).collect();
        let mut anchors: Vec<String> = Vec::new();
        for line in text.lines().filter(|line| line.starts_with('#')) {
            let own = anchor(line.trim_start_matches('#').trim());
            let mut names = std::iter::once(own.clone()).chain((1..).map(|n| format!("{own}-{n}")));
            anchors.extend(names.find(|name| !anchors.contains(name)));
        }
        anchors
    }
}

/// The anchor that forges and mdBook give a heading.
pub fn anchor(heading: &str) -> String {
    let kept = heading.to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

#[test]
fn ron_blocks_load() {
    let blocks: Vec<_> = pages().iter().flat_map(|page| page.blocks("ron")).collect();
    assert!(blocks.len() > 10, "only {} RON blocks were found", blocks.len());
    for (place, block) in blocks {
        for scene in scenes_of(&block) {
            try_load(&scene).unwrap_or_else(|error| panic!("{place}: {error}\n{scene}"));
        }
    }
    assert!(try_load(&wrapped("scale: WhiteLight")).is_ok() && try_load(&wrapped("scale: Whiter")).is_err());
}

fn try_load(scene: &str) -> lobelia::error::Result<()> {
    let folder = Data::bare();
    // Every second part between quotes is a string; those that could be files are made.
    for text in scene.split('"').skip(1).step_by(2).filter(|text| text.contains('.') && !text.contains('$')) {
        folder.write(text, "");
    }
    let path = folder.write("scene.ron", scene);
    load(&path, &LoadOptions { without_data: true, ..LoadOptions::default() }).map(drop)
}

/// The scenes that a block stands for.
fn scenes_of(block: &str) -> Vec<String> {
    let plain: String = block.lines().flat_map(|line| [line.split("//").next().unwrap(), "\n"]).collect();
    if plain.trim_start().starts_with("Scene") {
        return vec![block.to_owned()];
    }
    // The parts between commas that are in no brackets and no strings.
    let (mut items, mut depth, mut quoted) = (vec![String::new()], 0, false);
    for c in plain.chars() {
        match c {
            '"' => quoted = !quoted,
            '(' | '[' if !quoted => depth += 1,
            ')' | ']' if !quoted => depth -= 1,
            ',' if !quoted && depth == 0 => {
                items.push(String::new());
                continue;
            }
            _ => {}
        }
        items.last_mut().unwrap().push(c);
    }
    items.iter().map(|item| item.trim()).filter(|item| !item.is_empty()).map(wrapped).collect()
}

/// A small scene around one item.
fn wrapped(item: &str) -> String {
    let word = item.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default();
    let (mut surface, mut views, mut more) = ("Sphere()", r#"Dataset(path: "$DATA")"#, item.to_owned());
    if !item[word.len()..].trim_start().starts_with(':') {
        // What the pass needs before it: something that fits, the passes that it scores, and the
        // one that it saves.
        let mut before = if word == "Shape" { String::new() } else { "Fit(name: \"before\"), ".to_owned() };
        let named = |field: &str| -> Vec<&str> {
            item.split(&format!("{field}: \"")).skip(1).filter_map(|rest| rest.split('"').next()).collect()
        };
        for name in named("pass") {
            before += &format!("Render(name: \"{name}\"), ");
        }
        for name in named("of") {
            before += &format!("Edit(name: \"{name}\", edits: [Roughness(action: Set(0.5))]), ");
        }
        more = format!("passes: [{before}{item}]");
        if word == "Shape" {
            surface = "Unknown()";
        }
        if item.contains("SelfMade") {
            views = "Photographed(truth: (albedo: Constant(0.5, 0.5, 0.5), specular: (albedo: (0, 0, 0), roughness: 0.3), \
                     light: Lobes(lobes: [(axis: (0, 1, 0), sharpness: 1, amplitude: (1, 1, 1))])))";
        }
    }
    let given = [("surface", surface), ("views", views)].into_iter().filter(|(field, _)| *field != word);
    let given: String = given.map(|(field, value)| format!("{field}: {value}, ")).collect();
    format!("Scene(version: 1, {given}{more})")
}

#[test]
fn commands_in_sh_blocks_exist() {
    let mut count = 0;
    for (place, block) in pages().iter().flat_map(|page| page.blocks("sh")) {
        for line in block.replace("\\\n", " ").lines() {
            count += 1;
            check_command(line).unwrap_or_else(|problem| panic!("{place}: {problem}: {line}"));
        }
    }
    assert!(count > 10, "only {count} commands were found");
}

fn check_command(line: &str) -> Result<(), String> {
    let words = shlex::split(line.split(" # ").next().unwrap()).ok_or("no shell can read it")?;
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let there = |file: &str| {
        if repository().join(file).exists() { Ok(()) } else { Err(format!("there is no {file}")) }
    };
    let scene = words.iter().find(|word| word.starts_with("scenes/"));
    scene.map_or(Ok(()), |scene| there(scene))?;
    if let Some(at) = words.iter().position(|word| *word == "--example") {
        // What follows an example's `--` is its own.
        return there(&format!("examples/{}.rs", words[at + 1]));
    }
    let arguments = match words.as_slice() {
        ["lobelia", arguments @ ..] => arguments,
        ["cargo", "run", rest @ ..] => {
            rest.iter().position(|word| *word == "--").map_or(&[] as &[&str], |at| &rest[at + 1..])
        }
        _ => &[],
    };
    let Some(first) = arguments.first() else { return Ok(()) };
    let depth = if *first == "env" { 2 } else { 1 };
    let known = flags(&help(&arguments[..depth.min(arguments.len())])?);
    for flag in arguments.iter().filter(|word| word.starts_with("--")) {
        let flag = flag.split('=').next().unwrap_or(flag);
        known.get(flag).ok_or(format!("there is no {flag}"))?;
    }
    // Values of `--set` fit the scene.
    let values = arguments.windows(2).filter(|pair| pair[0] == "--set").map(|pair| pair[1]);
    let pairs = values.filter_map(|value| value.split_once('='));
    let sets = pairs.map(|(path, value)| (path.to_owned(), value.to_owned())).collect();
    if let Some(scene) = scene {
        let options = LoadOptions { sets, without_data: true, ..LoadOptions::default() };
        load(&repository().join(scene), &options).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// The help text of a command.
fn help(words: &[&str]) -> Result<String, String> {
    let said = Outcome::of(command(words).arg("--help"));
    if said.code == Some(0) { Ok(said.stdout) } else { Err(format!("there is no command {words:?}")) }
}

/// The commands that are listed under one.
fn commands_below(words: &[&str]) -> Vec<String> {
    let text = help(words).unwrap();
    let list = text.split("\nCommands:\n").nth(1).unwrap_or_default();
    let rows = list.lines().take_while(|line| !line.trim().is_empty());
    let names = rows.filter_map(|row| row.split_whitespace().next().map(str::to_owned));
    names.filter(|name| name != "help").collect()
}

/// The flags that a help text describes.
fn flags(help: &str) -> BTreeSet<String> {
    let described = help.lines().map(str::trim_start).filter(|line| line.starts_with('-'));
    let words = described.flat_map(|line| line.split([' ', ',', '=', '[']));
    let flags = words.map(|word| word.trim_end_matches([';', '.', ':']));
    flags.filter(|flag| flag.starts_with("--") && *flag != "--help").map(str::to_owned).collect()
}

/// Every command has a section in the command-line reference that names its flags, and no others.
#[test]
fn command_line_reference_is_complete() {
    let text = read("docs/src/command-line.md");
    let mut commands = Vec::new();
    for name in commands_below(&[]) {
        match commands_below(&[&name]) {
            parts if parts.is_empty() => commands.push(name),
            parts => commands.extend(parts.iter().map(|part| format!("{name} {part}"))),
        }
    }
    for command in &commands {
        let heading = format!("## `lobelia {command}`\n");
        let section = text.split(&heading).nth(1).unwrap_or_else(|| panic!("no section {heading}"));
        // A row of the table of flags begins with the flag.
        let rows = section.split("\n## ").next().unwrap().lines().filter_map(|row| row.strip_prefix("| `--"));
        let named = rows.map(|row| format!("--{}", row.split([' ', '`']).next().unwrap())).collect();
        let known = flags(&help(&command.split(' ').collect::<Vec<_>>()).unwrap());
        assert_eq!(known, named, "flags of `lobelia {command}`: in the help, in docs/src/command-line.md");
    }
    assert_eq!(text.matches("\n## `lobelia ").count(), commands.len(), "sections of other commands");
}

/// Scenes are found from where the documentation says they are.
#[test]
fn committed_scenes_load() {
    for (path, _) in files_with("scenes", "ron") {
        let options = LoadOptions { without_data: true, ..LoadOptions::default() };
        load(&repository().join(&path), &options).unwrap_or_else(|error| panic!("{path}: {error}"));
    }
}

#[test]
fn every_link_leads_somewhere() {
    let pages = pages();
    for page in &pages {
        for target in page.targets().iter().filter(|target| !target.contains("://")) {
            let followed = follow(page, target, &pages);
            followed.unwrap_or_else(|problem| panic!("{}: {target}: {problem}", page.path));
        }
    }
}

fn follow(page: &Page, target: &str, pages: &[Page]) -> Result<(), &'static str> {
    let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
    let own = repository().join(&page.path);
    let path = if file.is_empty() { own } else { own.with_file_name(file) };
    let path = path.canonicalize().map_err(|_| "there is no such file")?;
    let is_it = |page: &&Page| repository().join(&page.path).canonicalize().is_ok_and(|own| own == path);
    let other = pages.iter().find(is_it);
    let is_there = |page: &Page| page.anchors().iter().any(|known| known == anchor);
    if anchor.is_empty() || other.is_some_and(is_there) { Ok(()) } else { Err("there is no such heading") }
}

#[test]
fn readme_is_short() {
    let words = read("README.md").split_whitespace().count();
    assert!(words <= README_WORDS, "README.md has {words} words; {README_WORDS} are enough");
}

/// A `rust` block anywhere else would not be compiled.
#[test]
fn rust_blocks_are_in_pages_that_are_compiled() {
    for page in pages().iter().filter(|page| !RUST_PAGES.contains(&page.path.as_str())) {
        let places: Vec<String> = page.blocks("rust").into_iter().map(|block| block.0).collect();
        assert!(places.is_empty(), "{places:?}: add the page to RUST_PAGES and to src/lib.rs");
    }
}

/// The README links to every example and every scene, and `SUMMARY.md` to every chapter, and to
/// nothing else there.
#[test]
fn lists_are_complete() {
    let lists = [("README.md", "examples"), ("README.md", "scenes"), ("docs/src/SUMMARY.md", "docs/src")];
    for (file, folder) in lists {
        let page = Page { path: file.to_owned(), text: read(file) };
        let targets = page.targets();
        let below = if file == "README.md" { format!("{folder}/") } else { String::new() };
        let listed: BTreeSet<&str> = targets.iter().filter_map(|file| file.strip_prefix(&below)).collect();
        let entries = std::fs::read_dir(repository().join(folder)).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let there: BTreeSet<String> = names
            .filter(|name| file == "README.md" || name.ends_with(".md") && name != "SUMMARY.md")
            .collect();
        assert_eq!(listed, there.iter().map(String::as_str).collect(), "{folder} in {file}");
    }
}

/// Messages that the troubleshooting chapter explains are messages that the program has.
#[test]
fn messages_exist() {
    // Strings that go on in the next line are joined.
    let mut code = String::new();
    for (_, text) in ["src", "crates"].into_iter().flat_map(|folder| files_with(folder, "rs")) {
        code.extend(text.split("\\\n").map(str::trim_start));
    }
    let text = read("docs/src/troubleshooting.md");
    let table = text.split("\n## ").find(|section| section.starts_with("Messages")).unwrap();
    let cells = table.lines().filter_map(|line| line.strip_prefix("| `")?.split(" | ").next());
    // Between backticks stands a message, with … for what varies.
    let parts: Vec<&str> =
        cells.flat_map(|cell| cell.split('`').step_by(2)).flat_map(|of| of.split('…')).collect();
    let missing: Vec<&&str> = parts.iter().filter(|part| !code.contains(part.trim())).collect();
    assert!(missing.is_empty() && parts.len() > 8, "no message says {missing:?}");
}

/// The list of the dependencies' licenses has every dependency, and nothing else.
#[test]
fn licenses_of_all_dependencies_are_listed() {
    let (lock, page) = (read("Cargo.lock"), read("docs/licenses.md"));
    // Packages of this workspace have no source.
    let packages = lock.split("[[package]]").filter(|package| package.contains("\nsource = "));
    let locked: BTreeSet<&str> = packages.map(|package| package.split('"').nth(1).unwrap()).collect();
    let rows = page.lines().filter(|line| line.starts_with("| ") && line.contains('`'));
    let listed: BTreeSet<&str> = rows.flat_map(|row| row.split('`').skip(1).step_by(2)).collect();
    let [missing, gone] = [locked.difference(&listed), listed.difference(&locked)].map(Vec::from_iter);
    assert!(missing.is_empty(), "docs/licenses.md lacks {missing:?}: `cargo metadata` says their licenses");
    assert!(gone.is_empty() && locked.len() > 100, "docs/licenses.md has {gone:?}, which Cargo.lock has not");
}
