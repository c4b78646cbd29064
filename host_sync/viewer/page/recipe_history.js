// The recipe that is being made, with undo and redo. Keys are those of the recipe's file.

const EMPTY = { parameters: ["height"] };
const MOST = 200;

export class RecipeHistory {
  constructor() {
    this.states = [JSON.stringify(EMPTY)];
    this.at = 0;
    this.recipe = structuredClone(EMPTY);
  }

  /** Take a state that is still being changed, as while a shape is dragged. */
  draft(recipe) {
    this.recipe = recipe;
  }

  /** Take a state that undo goes back to; keys without a value are dropped. */
  commit(recipe) {
    const given = Object.entries(recipe).filter(([, value]) => value !== null && value !== undefined && value !== "" && value !== false
      && !(Array.isArray(value) && !value.length));
    if (!("parameters" in Object.fromEntries(given))) given.push(["parameters", []]);
    this.recipe = Object.fromEntries(given);
    const text = JSON.stringify(this.recipe);
    if (text === this.states[this.at]) return;
    this.states = [...this.states.slice(0, this.at + 1), text].slice(-MOST);
    this.at = this.states.length - 1;
  }

  get canUndo() {
    return this.at > 0;
  }

  get canRedo() {
    return this.at < this.states.length - 1;
  }

  move(steps) {
    this.at = Math.min(this.states.length - 1, Math.max(0, this.at + steps));
    this.recipe = JSON.parse(this.states[this.at]);
  }
}
