//! Files import each other in one direction. The cycles that are left stay within one concept each, and stand
//! in `docs/ARCHITECTURE.md`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::architecture::{code, root, rust_files};

/// Files that import each other in a circle: folders, or files without their extension.
const ALLOWED: [&[&str]; 8] = [
    &["crates/wear/src/estimate/tracker"],
    &[
        "src/asset/alarm_rules",
        "src/asset/bearing",
        "src/asset/gear_spec",
        "src/asset/other_mesh",
        "src/asset/spec",
    ],
    &["src/store"],
    &["src/service/streams"],
    &["src/cluster/intake", "src/cluster/worker"],
    &["src/cli/recordings/analyze"],
    &["src/cli/recordings/convert"],
    &["src/cli/client/stream"],
];

#[test]
fn files_import_each_other_in_one_direction() {
    let packages = fs::read_dir(root().join("crates")).unwrap().map(|entry| entry.unwrap().path());
    let sources = packages.map(|package| package.join("src")).chain([root().join("src")]);
    let mut wrong = Vec::new();
    for source in sources {
        let place = source.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
        for cycle in Modules::read(&source).cycles() {
            let files: Vec<String> =
                cycle.iter().map(|module| format!("{place}/{}", module.join("/"))).collect();
            let is_of = |file: &String, place: &str| {
                file.strip_prefix(place).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
            };
            let is_allowed =
                |places: &&[&str]| files.iter().all(|file| places.iter().any(|place| is_of(file, place)));
            if !ALLOWED.iter().any(is_allowed) {
                wrong.push(files.join(", "));
            }
        }
    }
    assert!(wrong.is_empty(), "files that import each other in a circle:\n{}", wrong.join("\n"));
}

#[test]
fn a_cycle_through_a_re_export_is_found() {
    let modules = |texts: &[(&str, &str)]| {
        let path = |name: &str| name.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect();
        Modules(texts.iter().map(|(name, text)| (path(name), File::of(text))).collect())
    };
    let facade = ("", "mod a; mod b; pub use a::A; pub use b::B;");
    let a = ("a", "use super::B; pub struct A(B);");
    let cycles = modules(&[facade, a, ("b", "pub struct B; fn f() -> crate::A {}")]).cycles();
    assert_eq!(cycles, [vec![vec!["a".to_owned()], vec!["b".to_owned()]]]);
    let none: Vec<Vec<ModulePath>> = Vec::new();
    assert_eq!(modules(&[facade, a, ("b", "pub struct B;")]).cycles(), none);
    let called = ("b", "pub struct B; pub(crate) fn f() { g(super::a::A) }");
    assert_eq!(modules(&[facade, a, called]).cycles().len(), 1);
    let group = ("a", "use crate::{c, b::{self, B}}; pub struct A;");
    assert_eq!(modules(&[facade, group, ("b", "use super::a::*;")]).cycles().len(), 1);
}

/// The path of a module below its package.
type ModulePath = Vec<String>;

/// What a file defines and imports.
struct File {
    defined: BTreeSet<String>,
    /// Paths as written, and whether the file re-exports what they name.
    used: Vec<(ModulePath, bool)>,
}

impl File {
    fn of(text: &str) -> Self {
        let tokens = tokens(text);
        let (mut defined, mut used) = (BTreeSet::new(), Vec::new());
        let mut at = 0;
        while at < tokens.len() {
            match tokens[at].as_str() {
                "struct" | "enum" | "fn" | "const" | "static" | "trait" | "type" => {
                    defined.extend(tokens.get(at + 1).cloned());
                }
                "use" => {
                    let end = at + tokens[at..].iter().position(|token| token == ";").unwrap_or(1);
                    let is_public = at > 0 && matches!(tokens[at - 1].as_str(), "pub" | ")");
                    let mut paths = Vec::new();
                    expand(&tokens[at + 1..end], &[], &mut paths);
                    used.extend(paths.into_iter().map(|path| (path, is_public)));
                    at = end;
                }
                "crate" | "super" if !is_visibility(&tokens[..at]) => {
                    let length =
                        tokens[at..].chunks(2).take_while(|pair| pair.get(1).is_some_and(|t| t == "::"));
                    let length = 2 * length.count() + 1;
                    let names = tokens[at..].iter().take(length).step_by(2);
                    used.push((names.cloned().collect(), false));
                    at += length - 1;
                }
                _ => {}
            }
            at += 1;
        }
        Self { defined, used }
    }
}

/// Whether a path behind these tokens belongs to `pub(…)` or `pub(in …)`, and imports nothing.
fn is_visibility(before: &[String]) -> bool {
    let before = before.strip_suffix(&["in".to_owned()]).unwrap_or(before);
    before.ends_with(&["pub".to_owned(), "(".to_owned()])
}

/// Splits code into names, `::` and other characters, without comments.
fn tokens(text: &str) -> Vec<String> {
    let mut tokens: Vec<String> = Vec::new();
    for line in text.lines() {
        let mut rest = line.split("//").next().unwrap_or_default();
        while let Some(first) = rest.chars().next() {
            let is_name = |c: char| c.is_alphanumeric() || c == '_';
            let length = match first {
                _ if is_name(first) => rest.find(|c| !is_name(c)).unwrap_or(rest.len()),
                ':' if rest.starts_with("::") => 2,
                _ => first.len_utf8(),
            };
            if !first.is_whitespace() {
                tokens.push(rest[..length].to_owned());
            }
            rest = &rest[length..];
        }
    }
    tokens
}

/// Expands the tree of a `use` item into its paths.
fn expand(tree: &[String], before: &[String], paths: &mut Vec<ModulePath>) {
    let mut path = before.to_vec();
    for (at, token) in tree.iter().enumerate() {
        match token.as_str() {
            "::" => {}
            "as" => break,
            "{" => {
                let (mut depth, mut start) = (0, at + 1);
                for (end, token) in tree.iter().enumerate().skip(at + 1) {
                    match token.as_str() {
                        "{" => depth += 1,
                        "}" if depth > 0 => depth -= 1,
                        "," | "}" if depth == 0 => {
                            expand(&tree[start..end], &path, paths);
                            start = end + 1;
                        }
                        _ => {}
                    }
                }
                return;
            }
            name => path.push(name.to_owned()),
        }
    }
    if path.len() > before.len() {
        paths.push(path);
    }
}

/// The files of one package by module.
struct Modules(BTreeMap<ModulePath, File>);

impl Modules {
    fn read(source: &Path) -> Self {
        let module = |file: &Path| -> ModulePath {
            let file = file.strip_prefix(source).unwrap().with_extension("");
            let parts = file.iter().map(|part| part.to_str().unwrap().to_owned());
            parts.filter(|part| !matches!(part.as_str(), "mod" | "lib")).collect()
        };
        let files = rust_files(source).into_iter().filter(|file| !file.ends_with("src/main.rs"));
        Self(files.map(|file| (module(&file), File::of(&code(&file)))).collect())
    }

    /// Returns a path as written in a module from the package's root on; `None` for one of another package.
    fn absolute(&self, module: &ModulePath, path: &[String]) -> Option<ModulePath> {
        let (mut at, mut rest) = (module.clone(), path);
        match rest.first()?.as_str() {
            "crate" => (at, rest) = (Vec::new(), &rest[1..]),
            "self" => rest = &rest[1..],
            "super" => {
                while rest.first().is_some_and(|name| name == "super") {
                    at.pop();
                    rest = &rest[1..];
                }
            }
            child => {
                at.push(child.to_owned());
                self.0.get(&at)?;
                rest = &rest[1..];
            }
        }
        at.extend_from_slice(rest);
        Some(at)
    }

    /// Returns the module whose file defines what a path from the root names.
    fn defining(&self, path: &ModulePath, seen: &mut BTreeSet<ModulePath>) -> Option<ModulePath> {
        let length = (0..=path.len()).rev().find(|&length| self.0.contains_key(&path[..length]))?;
        let module = path[..length].to_vec();
        let file = &self.0[&module];
        let Some(name) = path.get(length) else { return Some(module) };
        if name == "*" || name == "self" || file.defined.contains(name) || !seen.insert(path.clone()) {
            return Some(module);
        }
        for (used, is_public) in &file.used {
            let Some(mut used) = self.absolute(&module, used) else { continue };
            let is_glob = *is_public && used.last().is_some_and(|last| last == "*");
            if is_glob {
                used.pop();
                used.push(name.clone());
            }
            let found = if used.last() == Some(name) { self.defining(&used, seen) } else { None };
            let is_elsewhere = found.as_ref().is_some_and(|found| *found != module);
            if is_elsewhere && (!is_glob || self.0[found.as_ref().unwrap()].defined.contains(name)) {
                return found;
            }
        }
        Some(module)
    }

    /// Returns the modules that a module imports from.
    fn imports(&self, module: &ModulePath) -> BTreeSet<&ModulePath> {
        let used = self.0[module].used.iter().filter(|(_, is_public)| !is_public);
        let paths = used.filter_map(|(path, _)| self.absolute(module, path));
        let found = paths.filter_map(|path| self.defining(&path, &mut BTreeSet::new()));
        found.filter(|found| found != module).map(|found| self.0.get_key_value(&found).unwrap().0).collect()
    }

    /// Returns the groups of modules each of which reaches all others of its group.
    fn cycles(&self) -> Vec<Vec<ModulePath>> {
        let imports: BTreeMap<&ModulePath, BTreeSet<&ModulePath>> =
            self.0.keys().map(|module| (module, self.imports(module))).collect();
        let reached = |from: &ModulePath| -> BTreeSet<&ModulePath> {
            let (mut reached, mut open) = (BTreeSet::new(), imports[from].clone());
            while let Some(module) = open.pop_first() {
                if reached.insert(module) {
                    open.extend(imports[module].iter());
                }
            }
            reached
        };
        let reached: BTreeMap<&ModulePath, BTreeSet<&ModulePath>> =
            imports.keys().map(|module| (*module, reached(module))).collect();
        let mut cycles = BTreeSet::new();
        for (module, others) in &reached {
            if others.contains(module) {
                let cycle = others.iter().filter(|other| reached[**other].contains(module));
                cycles.insert(cycle.map(|other| (*other).clone()).collect::<Vec<ModulePath>>());
            }
        }
        cycles.into_iter().collect()
    }
}
