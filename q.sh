while read n; do [ -z "$n" ] && continue; r=$(pip index versions $n 2>/dev/null | head -1); [ -n "$r" ] && echo "$r"; done
