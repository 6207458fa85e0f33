/** A link to a state of the page. */
import type { ComponentChildren } from "preact";
import { address, open } from "../url/location";
import type { Query } from "../url/query";

export function Link(props: { to: Query; current?: boolean; children: ComponentChildren }) {
  const follow = (event: MouseEvent): void => {
    if (event.metaKey || event.ctrlKey || event.shiftKey || event.button !== 0) return;
    event.preventDefault();
    open(props.to);
  };
  return (
    <a href={address(props.to)} onClick={follow} aria-current={props.current ? "page" : undefined}>
      {props.children}
    </a>
  );
}
