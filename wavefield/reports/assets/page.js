"use strict";
(function () {
  // folded sections: opened by links to them, by a button for all, and for printing
  const sections = [...document.querySelectorAll("section.folded > details")];
  const button = document.getElementById("unfold");
  const reveal = () => {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    const inside = target && target.querySelector(":scope > details");
    if (inside) { inside.open = true; target.scrollIntoView(); }
  };
  const label = () => { button.textContent = sections.every((one) => one.open) ? "Fold all" : "Unfold all"; };
  if (!button) return;
  button.hidden = false;
  button.addEventListener("click", () => {
    const open = !sections.every((one) => one.open);
    for (const one of sections) one.open = open;
  });
  for (const one of sections) one.addEventListener("toggle", label);
  for (const link of document.querySelectorAll("nav a")) link.addEventListener("click", () => setTimeout(reveal));
  addEventListener("hashchange", reveal);
  let closed = [];
  addEventListener("beforeprint", () => { closed = sections.filter((one) => !one.open); for (const one of closed) one.open = true; });
  addEventListener("afterprint", () => { for (const one of closed) one.open = false; });
  reveal();
})();
