// Header and foot stay in place and grow with what they say: what has the focus is never under them.
const GAP = 8; // px, for the outline

export function edges(top, foot) {
  const root = document.documentElement;
  let known = "";
  const measure = () => {
    const now = `${top.offsetHeight} ${foot.offsetHeight}`;
    if (now === known) return; // a width alone has changed
    known = now;
    root.style.scrollPaddingTop = `${top.offsetHeight + GAP}px`;
    root.style.scrollPaddingBottom = `${foot.offsetHeight + GAP}px`;
    document.body.style.paddingBottom = `${foot.offsetHeight + GAP}px`; // the last one can be scrolled out from under it
    const one = document.activeElement;
    if (one && one.closest("main") && !one.matches("main, iframe")) one.scrollIntoView({ block: "nearest" });
  };
  const watch = new ResizeObserver(measure);
  for (const one of [top, foot]) watch.observe(one);
}
