// Code blocks of the language `math` are formulas on forges; here MathJax is told to set them.
document.querySelectorAll("code.language-math").forEach((code) => {
  const formula = document.createElement("div");
  formula.textContent = "\\[" + code.textContent + "\\]";
  code.parentElement.replaceWith(formula);
});
if (window.MathJax && window.MathJax.Hub) {
  window.MathJax.Hub.Queue(["Typeset", window.MathJax.Hub]);
}
