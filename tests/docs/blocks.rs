//! Code blocks of the documentation work: RON loads, and commands, flags, scenes and examples exist.
//!
//! A `ron` block is a whole `Scene(…)`, or a list of fields of a scene (`light: …`) and of passes (`Edit(…)`), each of which is put
//! into a small scene of its own. Files that a block names are made, empty, before it is loaded.

use super::markdown::{Page, names, pages, repository};
use lobelia::scene::{LoadOptions, load};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

#[test]
fn ron_blocks_load() {
    let mut problems = Vec::new();
    let mut count = 0;
    for page in pages() {
        for block in page.blocks().into_iter().filter(|block| block.language == "ron") {
            for scene in scenes_of(&block.text) {
                count += 1;
                if let Err(error) = try_load(&scene) {
                    problems.push(format!("{}:{}: {error}\n{scene}", page.path.display(), block.line));
                }
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n\n"));
    assert!(count > 10, "only {count} RON blocks were found");
}

fn try_load(scene: &str) -> Result<(), String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let path = folder.path().join("scene.ron");
    std::fs::write(&path, scene).map_err(|error| error.to_string())?;
    // Every second part between quotes is a string; those that could be files are made.
    for text in scene.split('"').skip(1).step_by(2) {
        let file = folder.path().join(text);
        if text.contains('.') && !text.contains('$') && !file.exists() {
            std::fs::create_dir_all(file.parent().unwrap()).map_err(|error| error.to_string())?;
            std::fs::write(&file, "").map_err(|error| error.to_string())?;
        }
    }
    let options = LoadOptions { without_data: true, ..LoadOptions::default() };
    load(&path, &options).map(|_| ()).map_err(|error| format!("{error:?}"))
}

/// The scenes that a block stands for.
fn scenes_of(block: &str) -> Vec<String> {
    let plain = without_comments(block);
    if plain.trim_start().starts_with("Scene") {
        return vec![block.to_owned()];
    }
    items(&plain).iter().map(|item| wrapped(item)).collect()
}

fn without_comments(text: &str) -> String {
    text.lines().map(|line| format!("{}\n", line.split("//").next().unwrap_or(line))).collect()
}

/// The parts of a fragment between commas that are in no brackets and no strings.
fn items(text: &str) -> Vec<String> {
    let (mut items, mut depth, mut quoted) = (vec![String::new()], 0, false);
    for c in text.chars() {
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
    items.iter().map(|item| item.trim().to_owned()).filter(|item| !item.is_empty()).collect()
}

/// A small scene around one item.
fn wrapped(item: &str) -> String {
    let word = item.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default();
    let is_field = item[word.len()..].trim_start().starts_with(':');
    let mut fields = BTreeMap::from([
        ("surface", "surface: Sphere()".to_owned()),
        ("views", "views: Dataset(path: \"$DATA\")".to_owned()),
    ]);
    if is_field {
        fields.insert(word, item.to_owned());
    } else {
        if word == "Shape" {
            fields.insert("surface", "surface: Unknown()".to_owned());
        }
        if item.contains("SelfMade") {
            let lobe = "(axis: (0, 1, 0), sharpness: 1, amplitude: (1, 1, 1))";
            let truth = "albedo: Constant(0.5, 0.5, 0.5), specular: (albedo: (0, 0, 0), roughness: 0.3)";
            let views = format!("views: Photographed(truth: ({truth}, light: Lobes(lobes: [{lobe}])))");
            fields.insert("views", views);
        }
        // What the pass needs before it: something that fits, the passes that it scores, and the one that it saves.
        let mut before = if word == "Shape" { String::new() } else { "Fit(name: \"before\"), ".to_owned() };
        for scored in item.split("pass: \"").skip(1) {
            before += &format!("Render(name: \"{}\"), ", scored.split('"').next().unwrap_or_default());
        }
        for shown in item.split("of: \"").skip(1) {
            before += &format!(
                "Edit(name: \"{}\", edits: [Roughness(action: Set(0.5))]), ",
                shown.split('"').next().unwrap_or_default()
            );
        }
        fields.insert("passes", format!("passes: [{before}{item}]"));
    }
    let fields: Vec<String> = fields.into_values().collect();
    format!("Scene(version: 1, {})", fields.join(", "))
}

#[test]
fn commands_in_sh_blocks_exist() {
    let mut help = Help::default();
    let mut problems = Vec::new();
    let mut count = 0;
    for page in pages() {
        for block in page.blocks().into_iter().filter(|block| block.language == "sh") {
            for line in block.text.replace("\\\n", " ").lines() {
                count += 1;
                if let Err(problem) = check_command(line, &mut help) {
                    problems.push(format!("{}:{}: {problem}: {line}", page.path.display(), block.line));
                }
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    assert!(count > 10, "only {count} commands were found");
}

fn check_command(line: &str, help: &mut Help) -> Result<(), String> {
    let words = words(line.split(" # ").next().unwrap_or(line));
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let scene = words.iter().find(|word| word.starts_with("scenes/"));
    if let Some(scene) = scene.filter(|scene| !repository().join(scene).exists()) {
        return Err(format!("there is no {scene}"));
    }
    if let Some(at) = words.iter().position(|word| *word == "--example")
        && !repository().join(format!("examples/{}.rs", words[at + 1])).exists()
    {
        return Err(format!("there is no example {}", words[at + 1]));
    }
    let arguments = match words.as_slice() {
        ["lobelia", arguments @ ..] => arguments,
        // What follows an example's `--` is its own.
        ["cargo", "run", ..] if words.contains(&"--example") => return Ok(()),
        ["cargo", "run", ..] => match words.iter().position(|word| *word == "--") {
            Some(at) => &words[at + 1..],
            None => return Ok(()),
        },
        _ => return Ok(()),
    };
    let depth = if arguments.first() == Some(&"env") { 2 } else { 1 };
    let command: Vec<&str> = arguments.iter().take(depth).copied().collect();
    let text = help.of(&command)?;
    for flag in arguments.iter().filter(|word| word.starts_with("--")) {
        let flag = flag.split('=').next().unwrap_or(flag);
        if !flags(&text).iter().any(|known| known == flag) {
            return Err(format!("there is no {flag}"));
        }
    }
    // Values of `--set` fit the scene.
    let set = |at: usize| arguments.get(at + 1)?.split_once('=').map(|(a, b)| (a.to_owned(), b.to_owned()));
    let sets: Vec<(String, String)> =
        (0..arguments.len()).filter(|at| arguments[*at] == "--set").filter_map(set).collect();
    if let (Some(scene), false) = (scene, sets.is_empty()) {
        let options = LoadOptions { sets, without_data: true, ..LoadOptions::default() };
        load(&repository().join(scene), &options).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// A command line's words, as a shell splits them.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut quote) = (vec![String::new()], None);
    for c in line.chars() {
        match (c, quote) {
            ('\'' | '"', None) => quote = Some(c),
            (c, Some(q)) if c == q => quote = None,
            (c, None) if c.is_whitespace() => words.push(String::new()),
            (c, _) => words.last_mut().unwrap().push(c),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Help texts, by command.
#[derive(Default)]
struct Help(BTreeMap<String, String>);

impl Help {
    fn of(&mut self, command: &[&str]) -> Result<String, String> {
        let key = command.join(" ");
        if !self.0.contains_key(&key) {
            let output =
                Command::new(env!("CARGO_BIN_EXE_lobelia")).args(command).arg("--help").output().unwrap();
            if !output.status.success() {
                return Err(format!("there is no command `{key}`"));
            }
            self.0.insert(key.clone(), String::from_utf8(output.stdout).unwrap());
        }
        Ok(self.0[&key].clone())
    }
}

/// The flags that a help text describes.
fn flags(help: &str) -> Vec<String> {
    let described = help.lines().map(str::trim_start).filter(|line| line.starts_with('-'));
    let words =
        described.flat_map(|line| line.split([' ', ',', '=', '['])).filter(|word| word.starts_with("--"));
    words.map(|word| word.trim_end_matches([';', '.', ':']).to_owned()).collect()
}

/// All commands, with those under them, as `--help` lists them.
fn commands(help: &mut Help) -> Vec<Vec<String>> {
    let below = |help: &mut Help, command: &[&str]| -> Vec<String> {
        let text = help.of(command).unwrap();
        let list = text.split("\nCommands:\n").nth(1).unwrap_or_default();
        let rows = list.lines().take_while(|line| !line.trim().is_empty());
        let names = rows.filter_map(|row| row.split_whitespace().next().map(str::to_owned));
        names.filter(|name| name != "help").collect()
    };
    let mut found = Vec::new();
    for name in below(help, &[]) {
        match below(help, &[&name]) {
            parts if parts.is_empty() => found.push(vec![name]),
            parts => found.extend(parts.into_iter().map(|part| vec![name.clone(), part])),
        }
    }
    found
}

/// Every command has a section in the command-line reference that names its flags, and no others.
#[test]
fn command_line_reference_is_complete() {
    let text = std::fs::read_to_string(repository().join("docs/src/command-line.md")).unwrap();
    let mut help = Help::default();
    let commands = commands(&mut help);
    assert!(commands.len() >= 13, "`--help` lists {commands:?}");
    for command in &commands {
        let heading = format!("## `lobelia {}`\n", command.join(" "));
        let section = text.split(&heading).nth(1).unwrap_or_else(|| panic!("no section {heading}"));
        let section = section.split("\n## ").next().unwrap();
        let words: Vec<&str> = command.iter().map(String::as_str).collect();
        let mut known = flags(&help.of(&words).unwrap());
        known.retain(|flag| flag != "--help");
        known.sort();
        known.dedup();
        // A row of the table of flags begins with the flag.
        let rows = section.lines().filter_map(|line| line.strip_prefix("| `--"));
        let mut named: Vec<String> =
            rows.map(|row| format!("--{}", row.split([' ', '`']).next().unwrap())).collect();
        named.sort();
        assert_eq!(named, known, "flags of `lobelia {}` in docs/src/command-line.md", command.join(" "));
    }
    let sections = text.lines().filter(|line| line.starts_with("## `lobelia ")).count();
    assert_eq!(sections, commands.len(), "docs/src/command-line.md has sections of other commands");
}

/// Scenes are found from where the documentation says they are.
#[test]
fn committed_scenes_load() {
    for name in names(Path::new("scenes")) {
        let options = LoadOptions { without_data: true, ..LoadOptions::default() };
        load(&repository().join("scenes").join(&name), &options)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
    }
}

#[test]
fn fragments_are_split_and_wrapped() {
    assert_eq!(items("a: (1, \"x,(\"),\nFit(),"), ["a: (1, \"x,(\")", "Fit()"]);
    assert_eq!(words("a --b='c d' \"e\""), ["a", "--b=c d", "e"]);
    let page = Page { path: "p".into(), text: "```ron\nscale: WhiteLight, // a, b\n```\n".to_owned() };
    let scenes = scenes_of(&page.blocks()[0].text);
    assert_eq!(scenes.len(), 1);
    assert!(try_load(&scenes[0]).is_ok() && try_load(&wrapped("scale: Whiter")).is_err());
}
