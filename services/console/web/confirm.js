// What is dangerous is asked twice.

import { Component, h } from "./vendor/preact.js";

/** What is asked a second time. @type {{text: string, go: () => void} | null} */
let question = null;
/** What had the keyboard before. @type {HTMLElement | null} */
let asker = null;

/** Asks once more before something that may move many robots. @param {string} text @param {() => void} go */
export function confirmThen(text, go) {
    asker = /** @type {HTMLElement | null} */ (document.activeElement);
    question = { text, go };
    confirm?.setState({});
}

/** @type {Confirm | null} */
let confirm = null;

export class Confirm extends Component {
    /** @type {HTMLElement | null} */
    root = null;

    componentDidMount() {
        confirm = this;
    }

    componentDidUpdate() {
        const dialog = /** @type {HTMLDialogElement} */ (this.root);
        if (question && !dialog.open) dialog.showModal();
    }

    render() {
        const end = (/** @type {boolean} */ yes) => {
            const asked = question;
            question = null;
            // At once: until it is closed, the rest of the page takes no key.
            /** @type {HTMLDialogElement} */ (this.root).close();
            asker?.focus();
            if (yes) asked?.go();
        };
        return h("dialog", { id: "confirm", ref: (/** @type {HTMLElement | null} */ root) => { this.root = root; }, "aria-labelledby": "confirm-text", onCancel: (/** @type {Event} */ event) => {
            event.preventDefault();
            end(false);
        } },
        h("p", { id: "confirm-text" }, question?.text ?? ""),
        h("div", { class: "line" },
            h("button", { type: "button", onClick: () => end(false) }, "Cancel"),
            h("button", { type: "button", class: "danger", onClick: () => end(true) }, "Do it")));
    }
}
