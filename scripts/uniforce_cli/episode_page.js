// Pictures, numbers and the line in the plots follow the slider. What is shown stands in the page as JSON:
// frames: numbers of the frames that have pictures; pictures: stream → base64 WebP of each; values: row → a list of
// newtons per frame; time_s; plot: [left, right] of the time line as shares of its width; press: band and limits, or null
const data = JSON.parse(document.getElementById("data").textContent);
const [left, right] = data.plot;
const last = data.time_s.length - 1;
const element = (id) => document.getElementById(id);
const slider = element("frame");

function pressWords(press_N) {
  const [low, high] = data.press.band_N;
  if (press_N < data.press.wiping_N) return ["not pressing", "none"];
  if (press_N < low) return [`press below ${low} to ${high} N`, "outside"];
  return press_N > high ? [`press above ${low} to ${high} N`, "outside"] : [`press within ${low} to ${high} N`, "inside"];
}

function show(frame) {
  slider.value = frame;
  const moment = data.frames.findLastIndex((number) => number <= frame);
  for (const [name, pictures] of Object.entries(data.pictures))
    element(name).src = `data:image/webp;base64,${pictures[moment]}`;
  for (const [row, values] of Object.entries(data.values))
    values[frame].forEach((newtons, column) => (element(row).cells[column + 1].textContent = newtons.toFixed(1)));
  element("time").textContent = `${data.time_s[frame].toFixed(2)} s`;
  element("number").textContent = `frame ${frame} of ${last}`;
  element("cursor").style.left = `${100 * (left + ((right - left) * frame) / Math.max(1, last))}%`;
  for (const button of document.querySelectorAll("#events button")) {
    const now = button.dataset.first <= frame && frame < button.dataset.end;
    button.setAttribute("aria-pressed", now);
  }
  if (data.press) [element("press").textContent, element("press").className] = pressWords(data.values.estimate[frame][0]);
}

let playing = null;
function play() {
  const from_ms = performance.now() - 1000 * data.time_s[slider.value < last ? slider.value : 0];
  playing = setInterval(() => {
    const now_s = (performance.now() - from_ms) / 1000;
    show(Math.max(0, data.time_s.findLastIndex((time) => time <= now_s)));
    if (now_s >= data.time_s[last]) pause();
  }, 50);
  element("play").textContent = "Pause";
}

function pause() {
  clearInterval(playing);
  playing = null;
  element("play").textContent = "Play";
}

element("play").addEventListener("click", () => (playing ? pause() : play()));
slider.addEventListener("input", () => {
  pause();
  show(Number(slider.value));
});
element("events").addEventListener("click", (event) => {
  if (event.target.dataset.first) show(Number(event.target.dataset.first));
});
element("plot").addEventListener("click", (event) => {
  const box = element("plot").getBoundingClientRect();
  const share = ((event.clientX - box.left) / box.width - left) / (right - left);
  show(Math.round(last * Math.min(1, Math.max(0, share))));
});
show(0);
