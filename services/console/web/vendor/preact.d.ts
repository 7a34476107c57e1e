// What the page uses of preact, for the check of types alone.
export class Component<P = any, S = any> {
    constructor(props?: P);
    props: P;
    state: S;
    setState(state: Partial<S> | ((state: S) => Partial<S>)): void;
    forceUpdate(): void;
    render(): any;
    componentDidMount?(): void;
    componentDidUpdate?(): void;
    componentWillUnmount?(): void;
}
export function h(type: any, props: any, ...children: any[]): any;
export function render(tree: any, parent: Element): void;
