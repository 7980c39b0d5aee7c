// News from the server: another story, what `check` found, how a search goes.

let falling = null;

/** The stage of a search, and how the energy falls. */
function searching({ stage, done, total, curve }) {
  $("search").hidden = false;
  if (!falling) {
    $("search").innerHTML = `<p></p><progress></progress>`;
    falling = new Chart($("search"), "Energy E(V)", "now, and the least (bold)");
  }
  $("search").querySelector("p").textContent = stage;
  Object.assign($("search").querySelector("progress"), { value: done, max: Math.max(total, 1) });
  if (curve.length < 2) return;
  const x = curve.map((_, i) => i), all = curve.flat(), low = Math.min(...all), high = Math.max(...all), log = low > 0 && high / low > 20;
  const curves = [0, 1].map((c) => ({ x, y: curve.map((row) => row[c]), colour: c ? INK : MUTED, width: c ? 2 : 1 }));
  falling.draw({ curves, until: curve.length - 1, low: log ? low : Math.min(low, 0), high: high || 1, log });
  falling.mark(null);
}

ready.then(() => {
  const news = new EventSource("news");
  let last = Promise.resolve();
  news.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    // One after another: a story takes longer to come than what is told of it.
    last = last.then(async () => {
      if (message.kind === "story") page.show(await unpacked(await (await fetch("story")).arrayBuffer()));
      if (message.kind === "certificate") page.judge(message.certificate);
      if (message.kind === "search") searching(message);
    });
  };
});
