// A click on the button starts the demo in its place.
for (const box of document.querySelectorAll(".demo")) {
  box.addEventListener("click", (event) => {
    const link = event.target.closest("a");
    if (!link || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    const frame = document.createElement("iframe");
    frame.src = link.href;
    frame.title = "eldenet in the browser";
    frame.addEventListener("load", () => {
      const page = frame.contentDocument.body;
      const fit = () => { frame.style.height = `${page.getBoundingClientRect().bottom + 16}px`; };
      new ResizeObserver(fit).observe(page);
    });
    box.replaceChildren(frame);
  });
}
