"use strict";
// The wipe: two pictures of a view on top of each other, with a line between them that a slider, a finger or the arrow keys move.
const by = (id) => document.getElementById(id);
const [dialog, stage, slider] = ["wipe", "stage", "slider"].map(by);
const sides = { left: [by("left"), by("left-choice")], right: [by("right"), by("right-choice")] };
// Views may be exchanged while the page is open.
let strips = [];
let shown = 0;

function place(percent) {
    slider.value = percent;
    stage.style.setProperty("--at", `${slider.value}%`);
}

function choose(side, index) {
    const [picture, choice] = sides[side];
    choice.selectedIndex = index;
    const source = strips[shown].querySelectorAll("img")[choice.selectedIndex];
    picture.src = source.src;
    picture.alt = source.alt;
}

function show(index) {
    // A view keeps what was chosen for the one before, if it has as many pictures.
    const before = Object.values(sides).map(([, choice]) => (choice.length ? choice.selectedIndex : -1));
    const same = sides.left[1].length;
    shown = (index + strips.length) % strips.length;
    const names = [...strips[shown].querySelectorAll("em")].map((name) => name.textContent);
    by("wipe-title").textContent = strips[shown].dataset.view;
    const keep = same === names.length;
    Object.entries(sides).forEach(([side, [, choice]], i) => {
        choice.replaceChildren(...names.map((name) => new Option(name)));
        choose(side, keep ? before[i] : Math.min(i, names.length - 1));
    });
    const several = names.length > 1;
    const { naturalWidth: width, naturalHeight: height } = strips[shown].querySelector("img");
    stage.style.setProperty("--aspect", width && height ? width / height : 1);
    slider.hidden = !several;
    by("line").hidden = !several;
}

addEventListener("click", (event) => {
    const strip = event.target.closest?.(".strip");
    if (!strip) return;
    strips = [...document.querySelectorAll(".strip")];
    show(strips.indexOf(strip));
    place(50);
    dialog.showModal();
    slider.focus();
});
dialog.addEventListener("close", () => {
    const strip = strips[shown];
    const folded = strip.closest("details");
    if (folded) folded.open = true;
    strip.focus();
});
slider.addEventListener("input", () => place(slider.value));
Object.entries(sides).forEach(([side, [, choice]]) =>
    choice.addEventListener("change", () => choose(side, choice.selectedIndex)));
by("previous").addEventListener("click", () => show(shown - 1));
by("next").addEventListener("click", () => show(shown + 1));
dialog.addEventListener("keydown", (event) => {
    if (event.target instanceof HTMLSelectElement) return;
    const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (step) {
        event.preventDefault();
        show(shown + step);
    }
});

function drag(event) {
    const box = stage.getBoundingClientRect();
    place((100 * (event.clientX - box.left)) / box.width);
}
stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    event.preventDefault();
    drag(event);
});
stage.addEventListener("pointermove", (event) => {
    if (event.buttons) drag(event);
});

// Paper has everything.
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => { part.open = true; }));
