// A short tone where the operator is needed, if it is wanted.
let context = null;
export const sound = {
  on: localStorage.getItem("sound") === "on",
  toggle() {
    this.on = !this.on;
    localStorage.setItem("sound", this.on ? "on" : "off");
    if (this.on) this.play(false);
    return this.on;
  },
  play(urgent) {
    if (!this.on) return;
    context = context || new AudioContext();
    const tone = context.createOscillator();
    const gain = context.createGain();
    tone.frequency.value = urgent ? 880 : 520;
    gain.gain.value = 0.15;
    tone.connect(gain).connect(context.destination);
    tone.start();
    tone.stop(context.currentTime + (urgent ? 0.5 : 0.2));
  },
};
